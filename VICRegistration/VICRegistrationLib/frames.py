"""Frame of files: LPS mm, as DICOM has it. In memory everything is RAS mm."""

from __future__ import annotations

import numpy as np

# Signs of the coordinates. Two of them turn over, so that nothing is mirrored; the way back is the same.
RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
RAS_TO_LPS.flags.writeable = False
