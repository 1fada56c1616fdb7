"""The preview in Slicer: a threshold is changed, and the region appears as a segment of a scene."""

from __future__ import annotations

import importlib.util
import itertools
import sys
from pathlib import Path
from statistics import median

import numpy as np
from measuring import interleaved_seconds, ratio, table
from scenes import organ_volume
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image

SIZE, SPACING = (512, 512, 30), (0.59, 0.59, 3.0)
_ROOT = Path(__file__).resolve().parents[2]


def report(*, quick: bool) -> str:
    """Compare a refreshed preview with one pass of labelling; skipped without Slicer's MRML library."""
    if importlib.util.find_spec("slicer") is None:
        return "  Skipped: slicer-core is not installed (pip install '.[test]' in a clone)."
    seconds = preview_seconds(organ_volume(SIZE, SPACING), 3 if quick else 15)
    preview, label = seconds["preview"], seconds["label"]
    return "\n\n".join(
        [
            f"  A volume node of {' x '.join(map(str, SIZE))} voxels. preview: a new threshold, separation, and the "
            "segment in Slicer's real\n  scene, without drawing. label: one pass of scipy.ndimage.label(volume > t).",
            table(
                [
                    ["", "preview / label", "preview ms", "slowest ms", "label ms"],
                    [
                        "preview",
                        f"{ratio(preview, label):.2f}",
                        f"{1e3 * median(preview):.0f}",
                        f"{1e3 * max(preview):.0f}",
                        f"{1e3 * median(label):.0f}",
                    ],
                ]
            ),
        ]
    )


def preview_seconds(image: Image, repeats: int) -> dict[str, list[float]]:
    """Seconds of refreshing the preview of the organ in the middle, and of labelling the volume."""
    sys.path[:0] = [str(_ROOT / "Testing" / "Python")]
    from slicer_stand_ins.install import install, loadModule

    scene = install().scene
    import mrml_boot
    import slicer

    from VICRegistration import VICRegistrationLogic
    from VICRegistrationLib.mrml.separating import separateOrgan

    module = loadModule(_ROOT / "VICRegistration" / "VICRegistration.py")
    try:
        volume = slicer.util.addVolumeFromArray(np.array(image.array), ijkToRAS=image.ijk_to_ras, name="mri")
        organ = VICRegistrationLogic().addOrgan(volume, np.zeros((1, 3)))
        low, high = organ.threshold.minimum, organ.threshold.maximum
        # Never the same twice in a row, as while a slider is dragged.
        lows = itertools.cycle((0.95 * low, low, 1.05 * low))

        def refresh():
            organ.setSeparation(threshold=(next(lows), high))
            separateOrgan(organ, volume)

        return interleaved_seconds({"preview": refresh, "label": lambda: ndimage.label(image.array > low)}, repeats)
    finally:
        module.unload()
        mrml_boot.clear(scene)
