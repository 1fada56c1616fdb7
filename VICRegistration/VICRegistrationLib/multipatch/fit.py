"""Fit of a generic model: its organs are fitted to an image, and a map of space moves everything else along."""

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

# One organ does not determine how the pelvis is turned.
_LEAST_ORGANS = 2
# With a smaller Jacobian determinant of the map, the parts that it moves no longer look like those of the model.
LEAST_DETERMINANT = 0.1
# A further stack, as a caller may give it.
Further = Union[Stack, Image, str, os.PathLike]
# Samples of an organ at which its distance from its region is measured, around and from pole to pole.
_SURFACE_SAMPLES = (48, 30)


@dataclass(frozen=True, eq=False)
class ModelFit:
    """Result of the fit of a generic model.

    Parameters
    ----------
    model : MultiPatchModel
        The model in the image, RAS mm. Parts that the image does not show are marked as estimated, predicted organs
        too.
    generic : MultiPatchModel
        The model before the fit.
    organs : dict of str to OrganFit
        Fits of the organs that the image shows.
    together : dict of str to BSplineSurface
        Their surfaces after the joint deformation, before each organ's own control points moved; RAS mm.
    placement : Placement
    carry : CarryingMap
        Map from the generic model to the image, RAS mm.
    landmarks : dict of str to float
        Distances of the given landmarks from where the map puts them, mm.
    seconds : float
        Time of the fit, without separating the regions.
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
        """Least Jacobian determinant of the map at the model's parts, and the name of the part there."""
        patches = self.generic.patches
        points = [patch_samples(self.generic, patch) for patch in patches]
        found = self.carry.determinants(np.concatenate(points)).reshape(len(patches), -1).min(axis=1)
        return float(found.min()), patches[int(found.argmin())].part

    @cached_property
    def sliding(self) -> dict[str, float]:
        """How far attachments slid along their organ, mm, by the attached part.

        Mean displacement, tangential to the organ's surface, of the points that a part shares with fitted organs, from
        the joint deformation to the end: what the fit by the organ's own control points did to them.
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
        """Find the indices of an organ's points that sheets and cords share, by the name of the part."""
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
        """Diagnostics of the result, without those of each organ's fit."""
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
        Separated organs on the image's grid, by their names in the model: at least two. The others are predicted.
    options : mapping of str to FitOptions, optional
        Options of some or all of these organs.
    landmarks : mapping of str to (3,) array_like, optional
        Positions of landmarks of the model in the image, RAS mm; any number of them.
    further : sequence of Stack, Image or path, or mapping of str to such sequences, optional
        More stacks of the patient, for all organs or for each; see :mod:`..registration.stacks`. How each was used is
        in `OrganFit.stacks`.

    Yields
    ------
    JointStep
        One for every iteration; the caller may stop between any two. While further stacks complete the region of an
        organ that the image cuts, the steps are of that organ alone.

    Returns
    -------
    ModelFit

    Raises
    ------
    ValueError
        If the model has no such organ or landmark, there are less than two organs, options do not fit the model, the
        image has another unit or frame, a landmark is more than 30 mm from where it is expected, or stacks are given
        for an organ without a region.
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
    """Move the organs that the image does not show by the map; they stay closed and smooth."""
    found = {}
    for name, parent in model.parents.items():
        if name not in known:
            net = parent.control_net
            closed = closed_organ(parent, closure=CLOSURE)
            found[name] = closed.deform(closed.fit(carry(net.reshape(-1, 3)).reshape(net.shape)))
    return found


def check_organs(model: MultiPatchModel, options: Mapping[str, FitOptions]) -> None:
    """Refuse organs that a model does not have, too few of them, and options that the model determines.

    Parameters
    ----------
    model : MultiPatchModel
    options : mapping of str to FitOptions
        Options of each organ that is to be fitted.

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
            f"Of the model's organs {names}, at least {_LEAST_ORGANS} are needed to place the model; given: "
            f"{', '.join(options) or 'none'}. Give seeds or regions of more of them."
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
