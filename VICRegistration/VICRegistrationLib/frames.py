"""Frames: coordinates are RAS mm in memory, and LPS mm in files, as in DICOM."""

from __future__ import annotations

import numpy as np

# Signs of the coordinates, for both directions. Two of them change, which is a rotation and no reflection.
RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
RAS_TO_LPS.flags.writeable = False
