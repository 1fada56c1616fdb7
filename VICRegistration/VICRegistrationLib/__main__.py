"""``python -m VICRegistrationLib``: the command line where the package is not installed."""

import sys

from .cli import main

sys.exit(main())
