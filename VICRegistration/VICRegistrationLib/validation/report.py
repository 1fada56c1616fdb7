"""The paper's validation as a table and plots: section 2.3 at both resolutions, and the example of figures 5 and 6."""

from __future__ import annotations

import csv
import io
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import write_text
from ..imaging.image import Image
from ..registration.stages import Step
from ..report.figure import require_packages
from . import one_dimensional, plots
from .prototypical import (
    BELL_MM,
    IMAGE_MM,
    RAMP_MM,
    SMOOTHING_MM,
    TESTS,
    PrototypicalTest,
    parameters_in,
    prototypical_image,
    run_test,
)

SIZES = (100, 200)
TABLE_CSV, TABLE_MD = "table.csv", "table.md"

_CHOICES = f"""\
## What the paper does not say, and what was chosen

- Size of the bell in the image of {IMAGE_MM:g} mm: {BELL_MM:g} mm, in the middle.
- The image below the bell's open rim: its wall goes on straight down.
- Strength of the Gaussian smoothing of the image: {SMOOTHING_MM:g} mm (standard deviation) at both resolutions.
- Local origin c of equation 2: the middle of the image.
- The way to the minimum: Gauss-Newton through four stages, in which the image is blurred by 10, 5, 2 and 0 mm and the
  ramp is 40, 20, 10 and {RAMP_MM:g} mm wide. The paper descends along the gradient of one cost. The surface lies in the
  middle of the ramp, in the image as in the fit.
- Grey levels of figure 5, which are printed as a curve only: the profile of equation 3 itself (A_max \
{one_dimensional.PROFILE.inside:g}, A_min
  {one_dimensional.PROFILE.outside:g}, tau {one_dimensional.PROFILE.width:g}) at {one_dimensional.TRUE_SHIFT:g} \
pixels, sampled at {one_dimensional.N_PIXELS} whole pixels and interpolated by a cubic spline.
"""


@dataclass(frozen=True, eq=False)
class Run:
    """One of the tests at one resolution.

    Parameters
    ----------
    test : PrototypicalTest
    size : int
        Voxels along each axis of the image.
    found : (n_free,) ndarray
        Free parameters after the registration, in the order of ``test.free``.
    history : tuple of Step
    seconds : float
        Time of the registration, without making the image.
    """

    test: PrototypicalTest
    size: int
    found: np.ndarray
    history: tuple[Step, ...]
    seconds: float

    @property
    def errors(self) -> np.ndarray:
        """Absolute deviations from theory, (n_free,)."""
        return np.abs(self.found - self.test.theory)


def reproduce(
    directory: str | os.PathLike,
    *,
    sizes: Sequence[int] = SIZES,
    say: Callable[[str], None] | None = None,
) -> None:
    """Repeat section 2.3 and figures 5 and 6, write table and plots, and print the table.

    Parameters
    ----------
    directory : path
        An existing folder; gets table.csv, table.md and PNG files named after the paper's figures.
    sizes : sequence of int
        Voxels along each axis of the images.
    say : callable, optional
        Called with lines of progress.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed, before anything is computed.
    OSError
        If a file cannot be written.
    """
    require_packages("matplotlib", otherwise="")
    say = say or (lambda line: None)
    directory = Path(directory)
    runs = []
    for size in sizes:
        say(f"image of {size} x {size} x {size} voxels: making it ...")
        image = prototypical_image(size)
        runs += run_tests(image, size, say=say)
        if size == sizes[0]:
            plots.bell_picture(directory / "figures_9_11_13_bell.png", image, {r.test.name: r.history for r in runs})
    for test, number in zip(TESTS, (10, 12, 14)):
        histories = {run.size: run.history for run in runs if run.test is test}
        name = "_".join(test.name.replace("+", "and").split())
        plots.convergence_plot(directory / f"figure_{number}_{name}.png", test, histories)
    pixels = one_dimensional.row_of_pixels()
    shift = one_dimensional.best_shift(pixels)
    say(f"example of figures 5 and 6: shift of {shift:.4f} pixels")
    plots.one_dimensional_plot(directory / "figures_5_6_one_dimension.png", pixels, shift)
    table = markdown(runs, shift)
    write_text(directory / TABLE_CSV, csv_text(runs))
    write_text(directory / TABLE_MD, table + "\n" + _CHOICES)
    print(table)


def run_tests(image: Image, size: int, *, say: Callable[[str], None]) -> list[Run]:
    """Run all tests of section 2.3 in one image.

    Parameters
    ----------
    image : Image
        From :func:`..validation.prototypical.prototypical_image`.
    size : int
        Its voxels along each axis.
    say : callable
        Called with a line after each test.

    Returns
    -------
    list of Run
    """
    runs = []
    for test in TESTS:
        start = time.perf_counter()
        found, history = run_test(test, image)
        run = Run(test, size, found, tuple(history), time.perf_counter() - start)
        runs.append(run)
        say(
            f"{test.name}, {size}^3: {len(history)} iterations, {run.seconds:.1f} s, "
            f"largest error {run.errors.max():.4f}{_unit(test.free[0])}"
        )
    return runs


def csv_text(runs: Sequence[Run]) -> str:
    """Make a CSV table with a row for each free parameter of each test.

    Parameters
    ----------
    runs : sequence of Run

    Returns
    -------
    str
        Columns: test, parameter, unit, imposed, theory; found, error, iterations and seconds for each size; and the
        paper's error at 100^3.
    """
    sizes = sorted({run.size for run in runs})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    per_size = [f"{word}_{size}" for size in sizes for word in ("found", "error", "iterations", "seconds")]
    writer.writerow(["test", "parameter", "unit", "imposed", "theory", *per_size, "error_paper"])
    for test in TESTS:
        own = sorted((run for run in runs if run.test is test), key=lambda run: run.size)
        imposed = parameters_in(test.imposed, test.free)
        for k, name in enumerate(test.free):
            cells = [
                test.name,
                name,
                _unit(name).strip() or "1",
                _number(imposed[k]),
                _number(test.theory[k]),
            ]
            for run in own:
                cells += [_number(run.found[k]), _number(run.errors[k]), len(run.history), f"{run.seconds:.3f}"]
            writer.writerow([*cells, test.paper_errors[k]])
    return text.getvalue()


def markdown(runs: Sequence[Run], shift: float) -> str:
    """Make the tables of the report.

    Parameters
    ----------
    runs : sequence of Run
    shift : float
        Result of the example of figures 5 and 6, pixels.

    Returns
    -------
    str
        Markdown.
    """
    sizes = sorted({run.size for run in runs})
    title = ["test", "parameter", "imposed", "theory"]
    title += [f"{word} {size}^3" for size in sizes for word in ("found", "error")] + ["error, paper"]
    rows, efforts = [], []
    for test in TESTS:
        own = sorted((run for run in runs if run.test is test), key=lambda run: run.size)
        imposed = parameters_in(test.imposed, test.free)
        for k, name in enumerate(test.free):
            numbers = [imposed[k], test.theory[k]]
            numbers += [number for run in own for number in (run.found[k], run.errors[k])]
            cells = [_number(number, 4) for number in numbers]
            rows.append([test.name if k == 0 else "", name + _unit(name), *cells, f"{test.paper_errors[k]:.2f}"])
        for run in own:
            worst, unit = f"{run.errors.max():.4f}", _unit(test.free[0])
            efforts.append([test.name, f"{run.size}^3", str(len(run.history)), f"{run.seconds:.1f}", worst + unit])
            efforts[-1].append(f"{max(test.paper_errors):.2f}{unit}")
    parts = [
        "# Validation of Jiang et al. (Strain 2019), repeated",
        "## Section 2.3, table 1: errors of the three tests",
        _table([title, *rows]),
        _table([["largest errors", "image", "iterations", "seconds", "here", "paper, 100^3"], *efforts]),
        "## Figures 5 and 6: a profile shifted along a row of pixels",
        _table(
            [
                ["", "shift in pixels"],
                ["true", f"{one_dimensional.TRUE_SHIFT:.4f}"],
                ["paper", "2.6"],
                ["found", f"{shift:.4f}"],
                ["error", f"{abs(shift - one_dimensional.TRUE_SHIFT):.4f}"],
            ]
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _unit(name: str) -> str:
    return " mm" if name[0] == "T" else ""


def _number(value: float, digits: int = 6) -> str:
    # Adding zero turns -0.0 into 0.0.
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def _table(rows: Sequence[Sequence[str]]) -> str:
    """Markdown table with columns of even width; the first row is the title."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    title, *lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths)) + " |" for row in rows]
    return "\n".join([title, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines])
