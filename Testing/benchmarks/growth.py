"""How time and memory of the local fit grow with samples, control points and voxels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median

import numpy as np
from measuring import exponent, interleaved_seconds, peak_megabytes, table
from scenes import ORGAN_LEVEL, WALL_LEVEL, organ_volume

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.sample_grid import SampledSurface, SampleGrid
from VICRegistrationLib.registration.stages import Stage, run_stage
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.registration.virtual_image import IntensityProfile, VirtualImage
from VICRegistrationLib.segmentation.separation import separate

ITERATIONS = 3
# Half axes of an ellipsoid a little inside of the organ, mm.
START = np.array([[0.0, 31.0, 0.0], [0.0, 0.0, 29.0], [34.0, 0.0, 0.0]])


def local_fit(image: Image, net: tuple[int, int], samples: tuple[int, int]) -> Callable[[], object]:
    """Make a local fit to the grey levels with a fixed number of iterations."""
    voxel = image.ijk_to_ras[:3, :3]
    stage = Stage(
        "local",
        Sampler(image),
        VirtualImage(IntensityProfile(ORGAN_LEVEL, WALL_LEVEL, 1.5), voxel=voxel),
        reach=0.5,
        n_depths=5,
        bending=1e-5,
        sliding=0.02,
        anchor=0.05,
        tolerance=0.0,
        max_iterations=ITERATIONS,
    )

    def job():
        model = models.closed_organ(net, axes=START)
        for _ in run_stage(stage, SampledSurface(closed_organ(model), SampleGrid.on(model, samples))):
            pass

    return job


def grown(names: Sequence[str], sizes: Sequence[int], jobs: Sequence[Callable[[], object]], repeats: int) -> str:
    """Table of times and memory with ratios to the first row, and the fitted exponents."""
    seconds = interleaved_seconds(dict(zip(names, jobs)), repeats)
    times = [median(seconds[name]) for name in names]
    memory = [peak_megabytes(job) for job in jobs]
    rows = [["", "size", "ms", "MB", "size ratio", "time ratio", "memory ratio"]]
    for name, size, passed, held in zip(names, sizes, times, memory):
        ratios = (f"{a / b:.1f}" for a, b in ((size, sizes[0]), (passed, times[0]), (held, memory[0])))
        rows.append([name, str(size), f"{1e3 * passed:.0f}", f"{held:.1f}", *ratios])
    return table(rows) + f"\n\n  time ~ size^{exponent(sizes, times):.2f}, memory ~ size^{exponent(sizes, memory):.2f}"


def report(*, quick: bool) -> str:
    """Measure all three kinds of growth."""
    image = organ_volume((160, 160, 32), (0.59, 0.59, 3.0))
    shapes = [(32, 20), (64, 40), (128, 80)] if quick else [(32, 20), (64, 40), (128, 80), (256, 160)]
    nets = [(9, 7), (17, 13), (33, 25)] if quick else [(9, 7), (17, 13), (33, 25), (65, 49)]
    repeats = 1 if quick else 3
    samples = grown(
        [f"{a} x {b}" for a, b in shapes],
        [a * b for a, b in shapes],
        [local_fit(image, (9, 7), shape) for shape in shapes],
        repeats,
    )
    points = grown(
        [f"{a} x {b}" for a, b in nets],
        [a * b for a, b in nets],
        [local_fit(image, net, (max(4 * (net[0] - 1), 24), max(4 * (net[1] - 3), 16))) for net in nets],
        1 if quick else 2,
    )
    return "\n\n".join(
        [
            f"  Local fit: {ITERATIONS} iterations on the grey levels; all that depends on the net is set up anew.\n"
            "  Memory: peak beyond the image, as tracemalloc sees it (numpy's arrays, not those inside of LAPACK or "
            "SuperLU).",
            "  Samples of the surface (net 9 x 7, 5 depths each):\n\n" + samples,
            "  Control points (4 samples for each span, in u and in v):\n\n" + points,
            "  Voxels (fit_region with default options: all stages; the net is chosen, the ramp follows the voxels):\n"
            "\n" + voxels(quick=quick),
        ]
    )


def voxels(*, quick: bool) -> str:
    """The same organ in a crop, in a large volume, and with finer pixels."""
    volumes = {
        "crop, 0.59 mm": organ_volume((160, 160, 32), (0.59, 0.59, 3.0)),
        "large, 0.59 mm": organ_volume((512, 512, 32 if quick else 100), (0.59, 0.59, 3.0)),
        "crop, 0.295 mm": organ_volume((320, 320, 32), (0.295, 0.295, 3.0)),
    }
    jobs = [_whole_fit(image) for image in volumes.values()]
    sizes = [image.array.size for image in volumes.values()]
    return grown(list(volumes), sizes, jobs, 3 if quick else 7)


def _whole_fit(image: Image) -> Callable[[], object]:
    region = separate(image, np.zeros((1, 3)))
    return lambda: finish(fit_region(image, region))
