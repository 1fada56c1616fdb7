"""A model of several organs and their supporting structures: named patches that share control points."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from ..geometry import bspline
from ..geometry.surface import BSplineSurface
from .cuts import OrganCuts, Pieces

KINDS = ("organ", "sheet", "cord")


@dataclass(frozen=True, eq=False)
class Part:
    """An anatomical structure: one or several patches.

    Parameters
    ----------
    name : str
    kind : {"organ", "sheet", "cord"}
        The patches of an organ are pieces of a closed surface. A sheet (fascia, broad ligament, pelvic floor) is open
        and has a thickness. A cord is a solid whose first section is a patch of an organ, its foot.
    thickness : float, optional
        Thickness of a sheet, mm.
    estimated : bool, optional
        True if images do not show the part. By default true for sheets and cords, false for organs.
    foot : str
        Name of the organ's patch that a cord begins at.

    Raises
    ------
    ValueError
        If the kind is unknown, a sheet has no positive thickness, or a cord no foot.
    """

    name: str
    kind: str
    thickness: float | None = None
    estimated: bool | None = None
    foot: str = ""

    def __post_init__(self) -> None:
        """Check the kind, and that a sheet has a thickness and a cord a foot."""
        if self.kind not in KINDS:
            msg = f"The part {self.name!r} is of the kind {self.kind!r}; choose one of {', '.join(KINDS)}."
            raise ValueError(msg)
        if self.kind == "sheet" and not (self.thickness is not None and 0.0 < self.thickness < np.inf):
            msg = f"The sheet {self.name!r} has the thickness {self.thickness}; give a positive number of mm."
            raise ValueError(msg)
        if self.kind == "cord" and not self.foot:
            msg = f"The cord {self.name!r} has no foot; name the organ's patch that it stands on."
            raise ValueError(msg)
        if self.estimated is None:
            object.__setattr__(self, "estimated", self.kind != "organ")

    def labelled(self, name: str = "") -> str:
        """Return the part's name, or the given name of a patch of it, with " (estimated)" if images do not show it."""
        return (name or self.name) + (" (estimated)" if self.estimated else "")


@dataclass(frozen=True, eq=False)
class Patch:
    """A B-spline patch, whose control points are points of its model.

    Parameters
    ----------
    name : str
        Unique in the model.
    part : str
        Name of the part that it belongs to.
    degrees : (p, q)
    knots : (u, v) of ndarray
        Clamped knot vectors.
    indices : (n_u, n_v) ndarray of int
        Its control points: rows of the model's ``points``.

    Raises
    ------
    ValueError
        If knots and indices do not fit together.
    """

    name: str
    part: str
    degrees: tuple[int, int]
    knots: tuple[np.ndarray, np.ndarray]
    indices: np.ndarray

    def __post_init__(self) -> None:
        """Check the knots against the indices and make the arrays read-only."""
        indices = np.array(self.indices)
        knots = tuple(bspline.validated_knots(degree, part) for degree, part in zip(self.degrees, self.knots))
        needed = tuple(len(part) - degree - 1 for degree, part in zip(self.degrees, knots))
        if indices.shape != needed or indices.dtype.kind not in "iu":
            msg = f"The patch {self.name!r} has indices of shape {indices.shape}; its degrees and knots need {needed}."
            raise ValueError(msg)
        for array in (*knots, indices):
            array.flags.writeable = False
        object.__setattr__(self, "degrees", tuple(int(degree) for degree in self.degrees))
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "indices", indices)

    def surface(self, points: np.ndarray) -> BSplineSurface:
        """Return the patch as an open surface, for the model's points (N, 3), RAS mm."""
        return BSplineSurface(self.degrees, *self.knots, np.asarray(points)[self.indices])

    def borders(self) -> dict[str, np.ndarray]:
        """Return indices of the control points along its borders, by "u_min", "u_max", "v_min" and "v_max"."""
        return borders_of(self.indices)


@dataclass(frozen=True, eq=False)
class MultiPatchModel:
    """Organs, ligaments, fasciae and muscles as patches over one array of points; made by :func:`assembled`.

    Patches with a common border share the control points there, so that the model stays watertight when points move.

    Parameters
    ----------
    points : (N, 3) ndarray
        Control points, RAS mm: those of each organ, then the free points, which belong to no organ.
    patches : tuple of Patch
    parts : tuple of Part
    parents : dict of str to BSplineSurface
        The closed surface of each organ, keyed by the name of its part.
    cuts : dict of str to OrganCuts
        How each organ is cut into patches.
    fixed : dict of str to (n,) ndarray of int
        Indices of the points that are fixed to bone, by the name of the place.
    landmarks : dict of str to (3,) ndarray
        Named points on bone, RAS mm.
    name : str

    Examples
    --------
    The pelvis that ships; parts that no image shows are marked as estimated:

    >>> from VICRegistrationLib import find_model
    >>> model = find_model("pelvis")
    >>> model.organs
    ('bladder', 'vagina', 'rectum')
    >>> [part.name for part in model.parts if part.kind == "cord" and part.estimated][:2]
    ['right uterosacral ligament', 'right pubourethral ligament']
    >>> model.surface("vagina wall posterior")
    BSplineSurface(5 x 7 control points of degrees (3, 3), 49.3 mm large)
    """

    points: np.ndarray
    patches: tuple[Patch, ...]
    parts: tuple[Part, ...]
    parents: Mapping[str, BSplineSurface]
    cuts: Mapping[str, OrganCuts]
    fixed: Mapping[str, np.ndarray] = field(default_factory=dict)
    landmarks: Mapping[str, np.ndarray] = field(default_factory=dict)
    name: str = ""

    def __repr__(self) -> str:
        """Show the sizes, not the points."""
        return f"MultiPatchModel({len(self.parts)} parts, {len(self.patches)} patches, {len(self.points)} points)"

    @property
    def organs(self) -> tuple[str, ...]:
        """Names of the organs."""
        return tuple(self.parents)

    def part(self, name: str) -> Part:
        """Return the part of that name."""
        return next(part for part in self.parts if part.name == name)

    def patch(self, name: str) -> Patch:
        """Return the patch of that name."""
        return next(patch for patch in self.patches if patch.name == name)

    def patches_of(self, part: str) -> tuple[Patch, ...]:
        """Patches of a part. The foot of a cord is a patch of the organ, and not among them."""
        return tuple(patch for patch in self.patches if patch.part == part)

    def indices_of(self, part: str) -> np.ndarray:
        """Sorted indices of all points of a part, those that it shares with others too."""
        return np.unique(np.concatenate([patch.indices.ravel() for patch in self.patches_of(part)]))

    def surface(self, patch: str) -> BSplineSurface:
        """Return the patch of that name as an open surface, RAS mm."""
        return self.patch(patch).surface(self.points)

    def ranges(self) -> dict[str, slice]:
        """Rows of ``points`` that belong to each organ, by its name."""
        first, places = 0, {}
        for organ, matrix in self._matrices.items():
            places[organ] = slice(first, first + matrix.shape[0])
            first += matrix.shape[0]
        return places

    @property
    def first_free(self) -> int:
        """Index of the first free point."""
        return max(place.stop for place in self.ranges().values())

    def organ_matrix(self, organ: str) -> sparse.csr_matrix:
        """Matrix K from an organ's control net to its points: ``K @ parent.control_net.reshape(-1, 3)``."""
        return self._matrices[organ]

    @cached_property
    def _matrices(self) -> dict[str, sparse.csr_matrix]:
        return {organ: self.cuts[organ].pieces(parent).matrix for organ, parent in self.parents.items()}

    def save(self, path: str | os.PathLike) -> None:
        """Write the model to a file, completely or not at all.

        Parameters
        ----------
        path : path
            The suffix chooses the format: .json (the whole model), .step or .stp (exact faces, for CAD), .vtp
            (triangles with the names of their patches), .png (a picture). The folder must exist.

        Raises
        ------
        ValueError
            If the suffix is of no such format, or a part is no valid solid (STEP).
        OSError
            If the file cannot be written; a file of that name is left as it was.
        RuntimeError
            If a picture is asked for and matplotlib is not installed.
        """
        # Imported here, because the formats import this module.
        from .formats import save_model

        save_model(self, path)

    def carried(
        self, parents: Mapping[str, BSplineSurface], carry: Callable[[np.ndarray], np.ndarray]
    ) -> MultiPatchModel:
        """Deform the model to another pelvis.

        Parameters
        ----------
        parents : mapping of str to BSplineSurface
            Closed surface of every organ in the other pelvis, RAS mm, with the same degrees and knots as here.
        carry : callable
            Maps points (n, 3) of this pelvis to the other one, RAS mm. It moves the free points and the landmarks; the
            points that sheets and cords share with an organ follow the organ.

        Returns
        -------
        MultiPatchModel

        Raises
        ------
        ValueError
            If an organ is missing or has other knots.
        """
        for organ, parent in self.parents.items():
            if organ not in parents:
                msg = f"The surface of the organ {organ!r} is missing; give one for each of {', '.join(self.parents)}."
                raise ValueError(msg)
            new = parents[organ]
            if new.degrees != parent.degrees or not (
                np.array_equal(new.knots_u, parent.knots_u) and np.array_equal(new.knots_v, parent.knots_v)
            ):
                msg = f"The surface of the organ {organ!r} has other degrees or knots than the model's; give the same."
                raise ValueError(msg)
        parents = {organ: parents[organ] for organ in self.parents}
        points = [self.cuts[organ].pieces(parent).matrix @ _flat(parent) for organ, parent in parents.items()]
        free = self.points[sum(map(len, points)) :]
        landmarks = dict(self.landmarks)
        if landmarks:
            landmarks = dict(zip(landmarks, carry(np.array(list(landmarks.values())))))
        if len(free):
            points.append(carry(free))
        return replace(self, points=np.concatenate(points), parents=parents, landmarks=landmarks)


def borders_of(grid: np.ndarray) -> dict[str, np.ndarray]:
    """Return views of the outer rows of a grid (n_u, n_v, ...), by "u_min", "u_max", "v_min" and "v_max"."""
    return {"u_min": grid[0], "u_max": grid[-1], "v_min": grid[:, 0], "v_max": grid[:, -1]}


def assembled(
    parents: Mapping[str, BSplineSurface],
    cuts: Mapping[str, OrganCuts],
    parts: Sequence[Part],
    *,
    free_points: np.ndarray = (),
    free_patches: Sequence[Patch] = (),
    fixed: Mapping[str, np.ndarray] | None = None,
    landmarks: Mapping[str, np.ndarray] | None = None,
    name: str = "",
) -> MultiPatchModel:
    """Make a model of closed surfaces, the cuts that divide them into patches, and further patches.

    Parameters
    ----------
    parents, cuts, parts, fixed, landmarks, name
        As in :class:`MultiPatchModel`.
    free_points : (n, 3) array_like
        Control points that belong to no organ, RAS mm. They are numbered after those of all organs.
    free_patches : sequence of Patch
        Patches of sheets and cords.

    Returns
    -------
    MultiPatchModel

    Raises
    ------
    ValueError
        If an organ cannot be cut like that, a name is missing or used twice, or an index is out of range.
    """
    organs = [part.name for part in parts if part.kind == "organ"]
    if sorted(organs) != sorted(parents) or sorted(organs) != sorted(cuts):
        msg = (
            f"The organs are {', '.join(organs) or 'none'}, with surfaces of {', '.join(parents) or 'none'} and cuts "
            f"of {', '.join(cuts) or 'none'}; every organ needs a closed surface and cuts."
        )
        raise ValueError(msg)
    points, patches, first = [], [], 0
    for organ, parent in parents.items():
        pieces = _pieces(organ, cuts[organ], parent)
        points.append(pieces.matrix @ _flat(parent))
        patches += [
            Patch(patch, organ, pieces.degrees, knots, indices + first) for patch, knots, indices in pieces.patches()
        ]
        first += len(points[-1])
    free = np.asarray(free_points, dtype=float).reshape(-1, 3)
    model = MultiPatchModel(
        np.concatenate([*points, free]),
        (*patches, *free_patches),
        tuple(parts),
        dict(parents),
        dict(cuts),
        {place: np.asarray(group, dtype=int) for place, group in (fixed or {}).items()},
        {place: np.asarray(point, dtype=float) for place, point in (landmarks or {}).items()},
        name,
    )
    _check(model)
    return model


def _flat(parent: BSplineSurface) -> np.ndarray:
    return parent.control_net.reshape(-1, 3)


def _pieces(organ: str, cuts: OrganCuts, parent: BSplineSurface) -> Pieces:
    try:
        return cuts.pieces(parent)
    except ValueError as error:
        msg = f"The organ {organ!r}: {error}"
        raise ValueError(msg) from error


def _check(model: MultiPatchModel) -> None:
    """Refuse missing and repeated names, indices out of range, and coordinates that are not finite."""
    names = [part.name for part in model.parts]
    for kind, given in (("part", names), ("patch", [patch.name for patch in model.patches])):
        twice = sorted({name for name in given if given.count(name) > 1})
        if twice or "" in given:
            msg = (
                f"Every {kind} needs a name of its own; {twice[0]!r} is there twice."
                if twice
                else (f"A {kind} has no name; every {kind} needs one of its own.")
            )
            raise ValueError(msg)
    if not np.isfinite(model.points).all() or not all(
        point.shape == (3,) and np.isfinite(point).all() for point in model.landmarks.values()
    ):
        msg = "Points or landmarks are not finite; give three coordinates each, in mm."
        raise ValueError(msg)
    for patch in model.patches:
        if patch.part not in names:
            msg = (
                f"The patch {patch.name!r} belongs to {patch.part!r}, which is no part; give one of {', '.join(names)}."
            )
            raise ValueError(msg)
    groups = [*((patch.name, patch.indices) for patch in model.patches), *model.fixed.items()]
    for name, indices in groups:
        if indices.size and not (indices.min() >= 0 and indices.max() < len(model.points)):
            msg = (
                f"{name!r} has points numbered {indices.min()} to {indices.max()}; the model has the numbers 0 to "
                f"{len(model.points) - 1}."
            )
            raise ValueError(msg)
    for part in model.parts:
        if not model.patches_of(part.name):
            msg = f"The part {part.name!r} has no patch; give it one, or leave it out."
            raise ValueError(msg)
        if part.kind == "cord" and part.foot not in {patch.name for patch in model.patches}:
            msg = f"The cord {part.name!r} stands on {part.foot!r}, which is no patch; name an organ's patch."
            raise ValueError(msg)
