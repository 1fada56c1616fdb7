"""How right and how fast: ``python Testing/benchmarks/run.py``. Times are ratios against something in the same run.

Nothing passes or fails by time. The order of what is compared alternates, and medians are printed, because other
programs share the machine.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence

# Threads of linear algebra on cores that other programs use too would be measured instead of the work: matrices are
# small here, and waiting for a busy core takes many times longer than they do. To be set before numpy is imported,
# which is why the cases are imported late.
THREADS = "OMP_NUM_THREADS"

TITLES = {
    "accuracy": "Surfaces against truth and experts: fitted, smoothed triangles, the paper",
    "experts": "One click in real MRI",
    "nets": "Control nets of different sizes",
    "robustness": "Seeds and grey levels moved at random",
    "confidence": "Errors against the standard deviations that fits tell",
    "tubes": "Long, bent organs",
    "shapes": "Organs of random shape",
    "hippocampus": "Hippocampi in brain MRI, started from a box",
    "surface": "From a separated region to a surface",
    "separation": "Separating an organ in a large volume",
    "growth": "Growth of the local fit",
    "sampling": "Sampling grey levels",
    "boundary": "Boundary points",
    "preview": "The preview in Slicer",
    "meshes": "Meshes of tetrahedra",
}


# Left out unless asked for.
LONG = ("confidence", "meshes")


def reports() -> dict[str, Callable[..., str]]:
    """Functions that measure a case and tell about it."""
    import accuracy
    import boundaries
    import confidence
    import experts
    import growth
    import hippocampus
    import meshes
    import nets
    import previews
    import random_organs
    import robustness
    import surfaces
    import tubes
    import volumes

    functions = {
        "accuracy": accuracy.report,
        "experts": experts.report,
        "nets": nets.report,
        "robustness": robustness.report,
        "confidence": confidence.report,
        "tubes": tubes.report,
        "shapes": random_organs.report,
        "hippocampus": hippocampus.report,
        "surface": surfaces.report,
        "separation": volumes.separation_report,
        "growth": growth.report,
        "sampling": volumes.sampling_report,
        "boundary": boundaries.report,
        "preview": previews.report,
        "meshes": meshes.report,
    }
    return {name: functions[name] for name in TITLES}


def machine() -> str:
    """What the numbers were measured on."""
    import numpy
    import scipy
    import SimpleITK
    from vtkmodules.vtkCommonCore import vtkVersion

    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    versions = {
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "VTK": vtkVersion.GetVTKVersion(),
        "SimpleITK": SimpleITK.Version_VersionString(),
    }
    return (
        f"{usable} cores, {platform.machine()}, {platform.system()}; Python {platform.python_version()}, "
        f"{', '.join(f'{name} {version}' for name, version in versions.items())}; "
        f"one process, {THREADS}={os.environ.get(THREADS, 'not set')}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer repeats and smaller sizes")
    parser.add_argument(
        "--all", action="store_true", help="also what takes a quarter of an hour or more: " + ", ".join(LONG)
    )
    parser.add_argument("--only", metavar="NAME", choices=tuple(TITLES), help=f"one of {', '.join(TITLES)}")
    options = parser.parse_args(arguments)
    os.environ.setdefault(THREADS, "1")
    print(f"Benchmark of VICRegistration\n{machine()}", flush=True)
    for name, report in reports().items():
        if name == options.only or (options.only is None and (options.all or options.quick or name not in LONG)):
            start = time.perf_counter()
            text = report(quick=options.quick)
            print(f"\n{TITLES[name]} ({name}, {time.perf_counter() - start:.0f} s)\n\n{text}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
