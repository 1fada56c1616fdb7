"""Accuracy and speed: ``python Testing/benchmarks/run.py``. Times are ratios against other work in the same run.

Nothing passes or fails by time. The order of what is compared alternates, and medians are printed, because other
programs share the machine.
"""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import sys
import time
from collections.abc import Sequence

import records

# Threads of linear algebra on cores that other programs use too would be measured instead of the work: matrices are
# small here, and waiting for a busy core takes many times longer than they do. To be set before numpy is imported,
# which is why the cases are imported late.
THREADS = "OMP_NUM_THREADS"

# What there is to measure: the module and its function, and the title of the report.
BENCHMARKS = {
    "accuracy": ("accuracy.report", "Surfaces against truth and experts: fitted, smoothed triangles, the paper"),
    "experts": ("experts.report", "One click in real MRI"),
    "clicks": ("clicks.report", "Clicks anywhere"),
    "verdicts": ("verdicts.report", "Verdicts on real MRI that was changed"),
    "constants": ("constants.report", "Half and twice each constant of the separation"),
    "nets": ("nets.report", "Control nets of different sizes"),
    "volumes": ("phantom_volumes.report", "Volumes of the demo's organs in other voxels"),
    "robustness": ("robustness.report", "Seeds and grey levels moved at random"),
    "confidence": ("confidence.report", "Errors against the standard deviations of the fits"),
    "stacks": ("stacks.report", "Several stacks of one patient"),
    "tubes": ("tubes.report", "Long, bent organs"),
    "shapes": ("random_organs.report", "Organs of random shape"),
    "hippocampus": ("hippocampus.report", "Hippocampi in brain MRI, started from a box"),
    "surface": ("surfaces.report", "From a separated region to a surface"),
    "separation": ("volumes.separation_report", "Separating an organ in a large volume"),
    "growth": ("growth.report", "Growth of the local fit"),
    "sampling": ("volumes.sampling_report", "Sampling grey levels"),
    "boundary": ("boundaries.report", "Boundary points"),
    "corrections": ("corrections.report", "Boundary points where the start is wrong"),
    "meshes": ("meshes.report", "Meshes of tetrahedra"),
    "models": ("models.report", "Generic models of several organs"),
    "modelfits": ("model_fits.report", "Generic models fitted to images"),
    "kills": ("kills.report", "Fits that are killed at random moments"),
    "reproduce": ("reproduced.report", "The paper's validation"),
    "clone": ("fresh_clone.report", "The two commands in a fresh clone"),
}
# Left out unless asked for.
LONG = ("confidence", "meshes", "clicks", "verdicts", "constants", "kills", "clone")


def report(name: str, *, quick: bool) -> str:
    """Measure a case and describe it; its module is imported here, after the threads are set."""
    module, _, function = BENCHMARKS[name][0].partition(".")
    return getattr(importlib.import_module(module), function)(quick=quick)


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
    parser.add_argument("--only", metavar="NAME", choices=tuple(BENCHMARKS), help=f"one of {', '.join(BENCHMARKS)}")
    parser.add_argument(
        "--write", action="store_true", help="keep what is printed in docs/measured, and renew the tables of the pages"
    )
    options = parser.parse_args(arguments)
    if options.write and options.quick:
        parser.error("--write keeps full measurements: leave --quick out")
    os.environ.setdefault(THREADS, "1")
    print(f"Benchmark of VICRegistration\n{machine()}", flush=True)
    for name, (_, title) in BENCHMARKS.items():
        if name == options.only or (options.only is None and (options.all or options.quick or name not in LONG)):
            start = time.perf_counter()
            text = report(name, quick=options.quick)
            print(f"\n{title} ({name}, {time.perf_counter() - start:.0f} s)\n\n{text}", flush=True)
            if options.write:
                records.write_record(name, title, machine(), text)
    return records.main() if options.write else 0


if __name__ == "__main__":
    sys.exit(main())
