"""How a generic model is fitted to an image: its organs to what is seen, and everything else carried along."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Union

import numpy as np

from ..geometry.parametrization import closed_organ
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image, as_image
from ..imaging.region import Region
from ..messages import Diagnostic
from ..registration.nets import closure_of
from ..registration.options import FitOptions
from ..registration.organ_fit import OrganFit
from ..registration.region_image import region_image
from ..registration.schedule import REGION_MARGIN_MM
from ..registration.stacks import Stack, stacks_beside
from .carrying import CarryingMap
from .check import patch_samples, through_cords, through_organs
from .joint import CLOSURE, JointStep
from .landmarks import check_distances, check_names
from .model import MultiPatchModel
from .organs import fit_organs
from .placement import Placement

# With fewer organs it is not known how a pelvis is turned.
_LEAST_ORGANS = 2
# Where the map makes space smaller than this share, what it carries is no longer like the model.
LEAST_DETERMINANT = 0.1
# What a further stack is given as.
Further = Union[Stack, Image, str, os.PathLike]
# Where an organ is compared with its region.
_SURFACE_SAMPLES = (48, 30)


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A generic model in an image.

    Parameters
    ----------
    model : MultiPatchModel
        Carried to the image, RAS mm. What the image does not show is marked as estimated in its parts, predicted
        organs too.
    generic : MultiPatchModel
        As it was before.
    organs : dict of str to OrganFit
        Organs that the image shows.
    together : dict of str to BSplineSurface
        The same as they were deformed as one, RAS mm.
    placement : Placement
    carry : CarryingMap
        From the generic model's RAS mm to the image's.
    landmarks : dict of str to float
        Distances of the given landmarks from where the map puts them, mm.
    seconds : float
        From the separated regions to the carried model.
    """

    model: MultiPatchModel
    generic: MultiPatchModel
    organs: dict[str, OrganFit]
    together: dict[str, BSplineSurface]
    placement: Placement
    carry: CarryingMap
    landmarks: dict[str, float]
    seconds: float

    def __repr__(self) -> str:
        """Show the result in one line."""
        return (
            f"ModelFit({len(self.organs)} organs fitted, {len(self.predicted)} predicted, {len(self.estimated)} parts "
            f"estimated, smallest determinant {self.smallest_determinant[0]:.2f}, {self.seconds:.2g} s)"
        )

    @property
    def predicted(self) -> tuple[str, ...]:
        """Names of the organs that the image does not show."""
        return tuple(name for name in self.model.organs if name not in self.organs)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of all other parts that the image does not show."""
        names = (part.name for part in self.model.parts if part.estimated)
        return tuple(name for name in names if name not in self.model.organs)

    @cached_property
    def deviations(self) -> dict[str, float]:
        """Mean distance of each fitted organ from the boundary of its separated region, mm."""
        found = {}
        for name, fit in self.organs.items():
            region = region_image(fit.whole_region or fit.region, np.eye(4), margin=REGION_MARGIN_MM)
            values, seen = region.sampler.values(fit.surface.points(*fit.surface.midpoints(*_SURFACE_SAMPLES)))
            found[name] = float(np.abs(values[seen]).mean())
        return found

    @cached_property
    def smallest_determinant(self) -> tuple[float, str]:
        """By how much the map enlarges space at least, and the part where."""
        patches = self.generic.patches
        points = [patch_samples(self.generic, patch) for patch in patches]
        found = self.carry.determinants(np.concatenate(points)).reshape(len(patches), -1).min(axis=1)
        return float(found.min()), patches[int(found.argmin())].part

    @cached_property
    def sliding(self) -> dict[str, float]:
        """How far attachments slid within their organ, mm, by the attached part.

        The mean distance, along the organ's surface, of the points that a part shares with a fitted organ from where
        they were when all organs were deformed as one: what the organ's own control points did to them.
        """
        found = {}
        for organ, fit in self.organs.items():
            place, matrix = self.model.ranges()[organ], self.model.organ_matrix(organ)
            before, after = (
                matrix @ surface.control_net.reshape(-1, 3) for surface in (self.together[organ], fit.surface)
            )
            foot = closest_points(fit.surface, after).parameters
            normals, moved = fit.surface.normals(*foot.T), after - before
            along = moved - np.einsum("nk,nk->n", moved, normals)[:, None] * normals
            for part, indices in self._attached(place).items():
                found.setdefault(part, []).append(np.linalg.norm(along[indices - place.start], axis=1))
        return {part: float(np.concatenate(values).mean()) for part, values in found.items()}

    def _attached(self, place: slice) -> dict[str, np.ndarray]:
        """Points of an organ that other parts share with it."""
        found = {}
        for part in self.model.parts:
            if part.kind != "organ":
                indices = self.model.indices_of(part.name)
                indices = indices[(indices >= place.start) & (indices < place.stop)]
                if len(indices):
                    found[part.name] = indices
        return found

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What to know about the result, beside what there is about each organ's fit."""
        found = [Diagnostic("organ_predicted", {"organ": name}) for name in self.predicted]
        if self.estimated:
            found.append(Diagnostic("parts_estimated", {"parts": list(self.estimated)}))
        found.append(Diagnostic("header_trusted"))
        determinant, part = self.smallest_determinant
        if determinant < LEAST_DETERMINANT:
            found.append(Diagnostic("map_compresses", {"determinant": determinant, "part": part}))
        return (*found, *through_organs(self.model), *through_cords(self.model))


def fit_model(
    image: Image,
    model: MultiPatchModel,
    regions: Mapping[str, Region],
    options: Mapping[str, FitOptions] | None = None,
    *,
    landmarks: Mapping[str, np.ndarray] | None = None,
    further: Sequence[Further] | Mapping[str, Sequence[Further]] = (),
) -> Generator[JointStep, None, ModelFit]:
    """Fit a generic model to an image, step by step.

    Parameters
    ----------
    image : Image or path
        The grey levels.
    model : MultiPatchModel
    regions : mapping of str to Region
        Separated organs on the image's grid, by their names in the model: at least two. Others are predicted.
    options : mapping of str to FitOptions, optional
        Of some or all of these organs.
    landmarks : mapping of str to (3,) array_like, optional
        Where landmarks of the model are in the image, RAS mm; any number of them.
    further : sequence of Stack, Image or path, or mapping of str to such sequences, optional
        More stacks of the patient, of all organs or of each; their own control points are fitted to them as well, see
        :mod:`..registration.stacks`. What became of each is `OrganFit.stacks`.

    Yields
    ------
    JointStep
        One for every iteration; the caller may stop between any two. Where further stacks complete a region that the
        image cuts, its first ones are of that organ alone.

    Returns
    -------
    ModelFit

    Raises
    ------
    ValueError
        If an organ or a landmark is none of the model's, there are less than two organs, options do not fit the model,
        the image is of another unit or frame, a landmark is more than 30 mm from where it is expected, or stacks are
        given of an organ without a region.
    """
    start, image = time.perf_counter(), as_image(image)
    options = {name: (options or {}).get(name) or FitOptions() for name in regions}
    landmarks = {name: np.asarray(point, dtype=float) for name, point in (landmarks or {}).items()}
    check_organs(model, options)
    check_names(model, landmarks)
    stacks = _stacks_of(image, further, list(regions))
    fits, together, placement = yield from fit_organs(image, model.parents, regions, options, stacks)
    surfaces = {name: fit.surface for name, fit in fits.items()}
    carry = CarryingMap(model.parents, surfaces)
    distances = {}
    if landmarks:
        generic = np.array([model.landmarks[name] for name in landmarks])
        places = np.array(list(landmarks.values()))
        check_distances(landmarks, carry(generic))
        carry = CarryingMap(model.parents, surfaces, landmarks=generic, places=places)
        distances = dict(zip(landmarks, np.linalg.norm(carry(generic) - places, axis=1).tolist()))
    carried = model.carried({**_predicted(model, carry, surfaces), **surfaces}, carry)
    parts = tuple(
        replace(part, estimated=True) if part.kind == "organ" and part.name not in surfaces else part
        for part in carried.parts
    )
    carried = replace(carried, parts=parts)
    seconds = time.perf_counter() - start
    return ModelFit(carried, model, fits, together, placement, carry, distances, seconds)


def _stacks_of(
    image: Image, further: Sequence[Further] | Mapping[str, Sequence[Further]], names: Sequence[str]
) -> dict[str, tuple[Stack, ...]]:
    """Further stacks of each organ."""
    if not isinstance(further, Mapping):
        return dict.fromkeys(names, stacks_beside(image, further))
    unknown = [name for name in further if name not in names]
    if unknown:
        msg = (
            f"Further stacks were given of {unknown[0]!r}, which has no region; the organs to fit are "
            f"{', '.join(names)}. Leave them out, or give a region."
        )
        raise ValueError(msg)
    return {name: stacks_beside(image, further.get(name, ())) for name in names}


def _predicted(
    model: MultiPatchModel, carry: CarryingMap, known: Mapping[str, BSplineSurface]
) -> dict[str, BSplineSurface]:
    """Carry the organs that the image does not show; they stay closed and smooth."""
    found = {}
    for name, parent in model.parents.items():
        if name not in known:
            net = parent.control_net
            closed = closed_organ(parent, closure=CLOSURE)
            found[name] = closed.deform(closed.fit(carry(net.reshape(-1, 3)).reshape(net.shape)))
    return found


def check_organs(model: MultiPatchModel, options: Mapping[str, FitOptions]) -> None:
    """Refuse organs that a model has not, too few of them, and options that are the model's own.

    Parameters
    ----------
    model : MultiPatchModel
    options : mapping of str to FitOptions
        Of each organ that is to be fitted.

    Raises
    ------
    ValueError
        With a sentence for the user.
    """
    names = ", ".join(model.organs)
    unknown = [name for name in options if name not in model.parents]
    if unknown:
        msg = f"The model has no organ {unknown[0]!r}; it has {names}. Name the organs as the model does."
        raise ValueError(msg)
    if len(options) < _LEAST_ORGANS:
        msg = (
            f"{len(options)} of the model's organs {names} was given; at least {_LEAST_ORGANS} are needed to place the "
            "model. Give seeds or regions of more of them."
        )
        raise ValueError(msg)
    usual = FitOptions()
    for name in options:
        own = [key for key in ("net", "closure", "model") if getattr(options[name], key) != getattr(usual, key)]
        if own:
            msg = f"{name}: the option {own[0]} was given, but the generic model brings its own; leave it out."
            raise ValueError(msg)
        if closure_of(model.parents[name]) != CLOSURE:
            msg = f"The surface of {name} in the model is not smooth at its seam and poles; draw it with drawn()."
            raise ValueError(msg)
