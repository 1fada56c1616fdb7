"""Helpers for fits, which are generators of steps that return a result: run one, map its steps, record them."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from .stages import Step

# Of a fit of any kind: its steps, and its result.
_S, _R = TypeVar("_S"), TypeVar("_R")


def finish(steps: Generator[_S, None, _R], on_step: Callable[[_S], None] | None = None) -> _R:
    """Run a fit to its end, and return its result.

    Parameters
    ----------
    steps : generator
        From :func:`fit_organ`, :func:`fit_region`, :func:`.refit.refit` or :func:`.multipatch.fit.fit_model`.
    on_step : callable, optional
        Called with every step.

    Returns
    -------
    OrganFit or ModelFit

    Raises
    ------
    ValueError
        If the generator was exhausted before.
    """
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            if end.value is None:
                msg = "The fit had come to its end before; start a new one."
                raise ValueError(msg) from None
            return end.value
        if on_step is not None:
            on_step(step)


def mapped(steps: Generator[_S, None, _R], function: Callable[[_S], object]) -> Generator[object, None, _R]:
    """Apply a function to every step of a generator, and return the generator's result.

    Parameters
    ----------
    steps : generator
    function : callable

    Yields
    ------
    object

    Returns
    -------
    object
    """
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value
        yield function(step)


def recorded(
    steps: Generator[Step, None, _R], history: list[Step], *, local_to_ras: np.ndarray | None = None, prefix: str = ""
) -> Generator[Step, None, _R]:
    """Append all steps to a history, and return the result of the steps.

    Parameters
    ----------
    steps : generator of Step
    history : list of Step
    local_to_ras : (4, 4) ndarray, optional
        Frame of the fit: takes the surfaces to RAS mm.
    prefix : str
        Put before the names of the stages.

    Yields
    ------
    Step
        As appended.

    Returns
    -------
    object
    """

    def record(step: Step) -> Step:
        if local_to_ras is not None:
            step = replace(step, surface=step.surface.transformed(local_to_ras))
        if prefix:
            step = replace(step, stage=f"{prefix}{step.stage}")
        history.append(step)
        return step

    return mapped(steps, record)
