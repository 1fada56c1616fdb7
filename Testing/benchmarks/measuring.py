"""Measurements on a machine with other load: medians of repeats in alternating order, peak memory, growth."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np


def interleaved_seconds(jobs: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Seconds of every repeat of each job; jobs take turns, every other round backwards, after one round of warm-up."""
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for number in range(repeats + 1):
        order = list(jobs) if number % 2 else list(reversed(jobs))
        for name in order:
            start = time.perf_counter()
            jobs[name]()
            passed = time.perf_counter() - start
            if number:
                seconds[name].append(passed)
    return seconds


def ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """Median over the rounds of the ratio within a round, so that other load affects both."""
    return median(a / b for a, b in zip(ours, theirs))


def peak_megabytes(job: Callable[[], object]) -> float:
    """Peak memory that a job allocates, MB, by tracemalloc."""
    tracemalloc.start()
    try:
        job()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Slope p of values ~ sizes^p, by least squares of the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def table(rows: Sequence[Sequence[str]]) -> str:
    """Markdown table with columns of even width, the first to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    title, *lines = [
        "  | " + " | ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:]))]) + " |"
        for row in rows
    ]
    rule = "  |" + "|".join(["-" * (widths[0] + 2), *("-" * (width + 1) + ":" for width in widths[1:])]) + "|"
    return "\n".join([title, rule, *lines])
