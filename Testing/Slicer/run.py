"""Run all self tests in Slicer: ``Slicer --testing --no-main-window --python-script Testing/Slicer/run.py``.

Leave out ``--no-main-window`` to run them with the main window, and see them click. Slicer ends with 0 if all pass.
"""

from __future__ import annotations

import sys
import unittest
from pathlib import Path

import slicer

FOLDER = Path(__file__).resolve().parent


def main() -> int:
    """Run the module's own self test and those of the panel."""
    sys.path.insert(0, str(FOLDER))
    import VICRegistration

    loader = unittest.defaultTestLoader
    suite = unittest.TestSuite(loader.loadTestsFromName(path.stem) for path in sorted(FOLDER.glob("*_tests.py")))
    suite.addTest(loader.loadTestsFromTestCase(VICRegistration.VICRegistrationTest))
    result = unittest.TextTestRunner(stream=sys.stdout, verbosity=2).run(suite)
    return 0 if result.wasSuccessful() else 1


slicer.util.exit(main())
