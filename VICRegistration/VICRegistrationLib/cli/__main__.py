"""``python -m VICRegistrationLib.cli``: the command line where the package is not installed."""

import sys

from . import main

sys.exit(main())
