"""Fits that take less time: regions are kept, and for tests of what is around fits, there are no finer nets."""

from __future__ import annotations

import dataclasses
import functools
import hashlib

import numpy as np

from VICRegistrationLib.analysis.comparison import compare

# The command line takes functions by their names: it is imported before they are replaced.
from VICRegistrationLib.cli import fitting, model_fitting  # noqa: F401
from VICRegistrationLib.multipatch import fit
from VICRegistrationLib.registration import completion, finer_nets, organ, refit
from VICRegistrationLib.segmentation import separation

# Results by the digest of the arguments.
_results = {}


def without_finer_nets(monkeypatch):
    """Keep the first net where none is asked for: to try finer ones takes most of a fit's time."""
    monkeypatch.setattr(finer_nets, "MOST_HALVINGS", 0)


def without_shapes(monkeypatch):
    """Separate by grey levels alone: surfaces along rays take most of the time of a separation."""
    monkeypatch.setattr(separation, "_by_shape", _no_shape)


def _no_shape(*arguments):
    """Stand for a search that has found no surface."""
    return None, None


def compare_few_points(monkeypatch):
    """Compare surfaces by a tenth of the usual points."""
    monkeypatch.setitem(compare.__kwdefaults__, "n_points", 1000)


def keep_regions(monkeypatch):
    """Keep the results of separations, which take most of the time of a small fit, wherever a fit begins with one."""
    separate = _cached(separation.separate)
    for module in (separation, organ, completion, fitting):
        monkeypatch.setattr(module, "separate", separate)


def cache(monkeypatch):
    """Keep the results of fits; one that was cancelled or failed is not kept."""
    places = ((organ, "fit_region"), (fitting, "fit_region"), (refit, "refit"), (fit, "fit_model"))
    for module, name in places:
        monkeypatch.setattr(module, name, _cached_steps(getattr(module, name)))


def _cached(function):
    """Keep the regions that a function returns, by its arguments."""

    @functools.wraps(function)
    def cached(*arguments, **options):
        arguments = [_rounded(value) for value in arguments]
        # An option that is None is one that was not given.
        options = {name: _rounded(value) for name, value in options.items() if value is not None}
        key = _key(function, arguments, options)
        if key not in _results:
            _results[key] = region = function(*arguments, **options)
            # A test that changed the region would change those of others.
            region.mask.flags.writeable = False
        return _results[key]

    return cached


def _cached_steps(function):
    def cached(*arguments, **options):
        arguments = [_rounded(value) for value in arguments]
        options = {name: _rounded(value) for name, value in options.items()}
        key = _key(function, arguments, options)
        if key in _results:
            steps, result = _results[key]
            yield from steps
            return result
        steps, running = [], function(*arguments, **options)
        while True:
            try:
                steps.append(next(running))
            except StopIteration as end:
                _results[key] = steps, end.value
                return end.value
            yield steps[-1]

    return cached


def _rounded(value):
    """Round points to a nanometre: those that have gone through a transform and back are the same to that only.

    What a function gets is rounded too, not its key alone: its result must not depend on which test called it first.
    """
    return np.round(value, 6) + 0.0 if isinstance(value, np.ndarray) and value.dtype == float else value


def _key(function, arguments, options):
    """Digest of all numbers that go into a function."""
    # A function separates, or completes a region, in the way that is in force.
    digest = hashlib.blake2b(f"{function.__name__} {separation._by_shape.__name__}".encode())
    for value in (*arguments, *(part for item in sorted(options.items()) for part in item)):
        _add(digest, value)
    return digest.digest()


def _add(digest, value):
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _add(digest, getattr(value, field.name))
    elif isinstance(value, dict):
        for item in value.items():
            _add(digest, item)
    elif isinstance(value, (list, tuple)):
        for part in value:
            _add(digest, part)
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    else:
        digest.update(repr(value).encode())
