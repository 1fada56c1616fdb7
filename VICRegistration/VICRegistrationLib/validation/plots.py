"""Plots like the paper's figures 5 and 6 and 9 to 14. Needs matplotlib."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np

from ..geometry import models
from ..geometry.parametrization import affine
from ..geometry.triangulation import triangulate
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from ..registration.stages import Step
from ..report.figure import TEXT_COLOUR, blank_figure, finish_axes, save_figure
from ..report.views import SAGITTAL, View, cut, slice_of
from . import one_dimensional
from .prototypical import BELL_MM, IMAGE_MM, TESTS, PrototypicalTest

_START, _END = "#ff9a3c", "#35c6ff"
_COLOURS = ("#d1495b", "#2a9d8f", "#4d7fb8", "#e39b28", "#7d5ba6", "#6b7280", "#a3572c", "#c45bb0", "#5d8a1f")
_LINES = ("-", (0, (4, 2)), (0, (1, 1.5)))


def parameters(test: PrototypicalTest, history: Sequence[Step]) -> np.ndarray:
    """Compute the free parameters of equation 2 after each iteration.

    Parameters
    ----------
    test : PrototypicalTest
    history : sequence of Step
        From :func:`..validation.prototypical.run_test`.

    Returns
    -------
    (n_iterations + 1, n_free) ndarray
        In the order of ``test.free``; the first row is that of the start model.
    """
    start = models.bell(BELL_MM).transformed(test.imposed)
    parametrization = affine(start, free=test.free, center=np.zeros(3))
    at_start = np.array([1.0 if name in ("R00", "R11", "R22") else 0.0 for name in test.free])
    changes = [parametrization.fit(step.surface.control_net) for step in history]
    return at_start + np.array([np.zeros(len(test.free)), *changes])


def convergence_plot(path: str | os.PathLike, test: PrototypicalTest, histories: Mapping[int, Sequence[Step]]) -> None:
    """Draw cost and parameters against iterations, like figures 10, 12 and 14.

    Parameters
    ----------
    path : path
        PNG file to write.
    test : PrototypicalTest
    histories : mapping of int to sequence of Step
        Steps by the number of voxels along each axis of the image.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(12.0, 4.9)
    cost_axes, axes = figure.add_axes((0.07, 0.125, 0.38, 0.75)), figure.add_axes((0.53, 0.125, 0.33, 0.75))
    for (size, history), line in zip(histories.items(), _LINES):
        _draw_costs(cost_axes, history, line, with_labels=line == _LINES[0])
        cost_axes.plot([], [], color=TEXT_COLOUR, linestyle=line, linewidth=1.6, label=f"{size}³ voxels")
        values = parameters(test, history)
        for number, column in enumerate(values.T):
            colour = _COLOURS[number % len(_COLOURS)]
            axes.plot(column, color=colour, linestyle=line, linewidth=1.6, marker="o", markersize=2.2)
    for number, (name, target) in enumerate(zip(test.free, test.theory)):
        colour = _COLOURS[number % len(_COLOURS)]
        axes.axhline(target, color=colour, linewidth=0.8, alpha=0.45, zorder=0)
        axes.plot([], [], color=colour, linewidth=2.2, label=f"{name}  → {target:.3f}")
    unit = " (mm)" if test.free[0].startswith("T") else ""
    finish_axes(cost_axes, x="iteration", y="cost (mean squared residual)", title=f"{test.name}: cost, stage by stage")
    finish_axes(axes, x="iteration", y=f"free parameters{unit}", title=f"{test.name}: parameters")
    for either in (cost_axes, axes):
        either.xaxis.get_major_locator().set_params(integer=True)
    cost_axes.legend(frameon=False, fontsize=9)
    axes.legend(frameon=False, fontsize=9, title="parameter → theory", loc="center left", bbox_to_anchor=(1.02, 0.5))
    save_figure(figure, path)


def one_dimensional_plot(path: str | os.PathLike, pixels: np.ndarray, shift: float) -> None:
    """Draw the row of pixels with the profile in its place, and the cost, like figures 5 and 6.

    Parameters
    ----------
    path : path
        PNG file to write.
    pixels : (n,) ndarray
        Grey levels at whole pixels.
    shift : float
        Shift that was found, pixels.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(12.0, 4.9)
    row, axes = figure.add_axes((0.06, 0.125, 0.41, 0.75)), figure.add_axes((0.565, 0.125, 0.41, 0.75))
    profile, last = one_dimensional.PROFILE, len(pixels) - 1.0
    positions = np.linspace(0.0, last, 500)
    grey = one_dimensional.interpolated(pixels, positions)
    row.plot(positions, grey, color="#e39b28", linewidth=1.8, label="interpolated by a cubic spline")
    row.plot(pixels, color="#e39b28", linestyle="none", marker="o", markersize=6, label="pixels")
    samples = np.linspace(0.0, profile.width, 200)
    label = f"profile, shifted by {shift:.3f} pixels"
    row.plot(
        shift + samples, profile.value(samples), color="#d1495b", linewidth=2.2, linestyle=(0, (4, 2)), label=label
    )
    row.axvspan(shift, shift + profile.width, color="#d1495b", alpha=0.07, linewidth=0)
    row.legend(frameon=False, fontsize=9.5)
    shifts = np.linspace(0.0, last - profile.width, 400)
    costs = one_dimensional.cost(shifts, pixels)
    axes.plot(shifts, costs, color="#4d7fb8", linewidth=1.9)
    axes.axvline(2.6, color="#7d5ba6", linewidth=1.2, linestyle=(0, (4, 2)), label="minimum of the paper, 2.6")
    lowest = one_dimensional.cost(np.array([shift]), pixels)
    axes.plot([shift], lowest, color="#d1495b", linestyle="none", marker="o", label=f"minimum found, {shift:.4f}")
    axes.legend(frameon=False, fontsize=9.5)
    levels = f"A_max {profile.inside:g}, A_min {profile.outside:g}, tau {profile.width:g}"
    finish_axes(row, x="position (pixels)", y="grey level", title=f"Row of pixels and profile: {levels}")
    finish_axes(axes, x="shift (pixels)", y="cost (equation 4)", title="Cost of the shifted profile")
    save_figure(figure, path)


def bell_picture(path: str | os.PathLike, image: Image, histories: Mapping[str, Sequence[Step]]) -> None:
    """Draw the bell's contour in a slice of its image before and after each test, like figures 9, 11 and 13.

    Parameters
    ----------
    path : path
        PNG file to write.
    image : Image
        From :func:`..validation.prototypical.prototypical_image`.
    histories : mapping of str to sequence of Step
        Steps by the names of the tests.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(12.6, 4.9)
    view = View(SAGITTAL, np.zeros(3), 0.62 * IMAGE_MM)
    grey = slice_of(Sampler(image), view)
    tests = [test for test in TESTS if test.name in histories]
    for number, test in enumerate(tests):
        axes = figure.add_axes((0.015 + 0.33 * number, 0.1, 0.31, 0.8))
        axes.set_facecolor("#3a3f49")
        axes.imshow(grey, origin="lower", extent=view.extent, cmap="gray", vmin=0.0, vmax=1.0)
        start = models.bell(BELL_MM).transformed(test.imposed)
        for surface, colour, width in ((start, _START, 1.8), (histories[test.name][-1].surface, _END, 2.2)):
            for line in cut(triangulate(surface, resolution=(256, 96)), view):
                axes.plot(*line.T, color=colour, linewidth=width)
        left, right, bottom, top = view.extent
        axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[])
        axes.set_title(test.name, size=11, loc="left", color=TEXT_COLOUR)
    note = f"Plane in the middle of the image, {2 * view.half_width:g} mm wide; A is to the left, S up. "
    figure.text(0.015, 0.035, note, size=10, color=TEXT_COLOUR)
    figure.text(0.58, 0.035, "start model", size=10.5, color="#c96a12", weight="bold")
    figure.text(0.69, 0.035, "found surface", size=10.5, color="#0f86b8", weight="bold")
    save_figure(figure, path)


def _draw_costs(axes, history: Sequence[Step], line, *, with_labels: bool) -> None:
    """Draw the cost of each stage as a line of its own: costs of different blurs and ramps cannot be compared."""
    stages = list(dict.fromkeys(step.stage for step in history))
    first = 1
    for number, stage in enumerate(stages):
        costs = [step.cost for step in history if step.stage == stage]
        iterations = np.arange(first, first + len(costs))
        first += len(costs)
        style = {"linestyle": line, "linewidth": 1.6, "marker": "o", "markersize": 2.6}
        axes.semilogy(iterations, costs, color=_COLOURS[number], label=stage if with_labels else None, **style)
