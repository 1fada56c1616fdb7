"""Python packages that are not in Slicer, installed when they are needed and if the user agrees."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import subprocess

import slicer
from slicer.i18n import tr as _


def ensurePackage(name, requirement, purpose):
    """Look for a package, and offer to install it.

    Parameters
    ----------
    name : str
        What is imported.
    requirement : str
        What pip installs.
    purpose : str
        What it is needed for, as the user reads it.

    Returns
    -------
    bool
        Whether it is there now. In tests nothing is installed; why pip has failed is in the log.
    """
    if importlib.util.find_spec(name) is not None:
        return True
    question = _("{purpose} needs the package {name}, which is not part of Slicer. Install it now?").format(
        purpose=purpose, name=requirement
    )
    if slicer.app.testingEnabled() or not slicer.util.confirmOkCancelDisplay(question):
        return False
    try:
        # Slicer 5.11 and newer.
        from slicer.packaging import pip_install
    except ImportError:
        pip_install = slicer.util.pip_install
    try:
        pip_install(requirement)
    except (subprocess.CalledProcessError, RuntimeError, OSError):
        logging.exception("The package %s could not be installed", requirement)
        return False
    importlib.invalidate_caches()
    return importlib.util.find_spec(name) is not None
