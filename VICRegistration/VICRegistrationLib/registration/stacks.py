"""Further stacks of one patient: input of a fit, and what the fit reports about each.

A fit takes the image in which the organ was separated, and any number of further images::

    fit = vic.fit("sag.nii.gz", seeds, further=["ax.nii.gz", "cor.nii.gz"])
    for stack in fit.stacks:
        print(stack.name, stack.used, stack.translation_mm, stack.rotation_degrees)

The patient moves between two stacks, so that a rigid motion is found for each further stack, see :mod:`.alignment`. It
holds for one organ only, because organs also fill and slide. A stack that contradicts the first one is left out, with
the reason.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..imaging.image import Image, as_image
from ..messages import Diagnostic

# Tolerance for equal matrices, mm, because files store them in single precision or as text.
_SAME_MM = 1e-2


@dataclass(frozen=True, eq=False)
class Stack:
    """A further image of the organ.

    Parameters
    ----------
    image : Image or path
        In its own RAS mm, on any grid, in any contrast.
    name : str
        For messages and results; the name of the file, or a number, if not given.
    motion : (4, 4) array_like
        Initial motion: takes points of the first image to this one, RAS mm. The identity if not given; to fit again,
        `StackUse.motion` of the earlier fit.

    Examples
    --------
    A ball in slices of two directions, the second time 2 mm higher:

    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> def ball(matrix, center):
    ...     k, j, i = np.indices((24, 24, 24))
    ...     ras = np.stack([i, j, k], axis=-1) @ matrix[:3, :3].T + matrix[:3, 3]
    ...     distance = np.linalg.norm((ras - center) / [1.0, 1.2, 0.8], axis=-1)
    ...     return vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), matrix)
    >>> sagittal = ball(np.diag([2.5, 2, 2, 1]), [28, 23, 23])
    >>> axial = ball(np.diag([2, 2, 2.5, 1]), [28, 23, 25])
    >>> fit = vic.fit(sagittal, [[28, 23, 23]], net=(9, 7), further=[vic.Stack(axial, "axial")])
    >>> stack = fit.stacks[0]
    >>> stack.name, stack.used, bool(abs(stack.translation_mm - [0, 0, 2]).max() < 0.1)
    ('axial', True, True)
    """

    image: Image
    name: str = ""
    motion: np.ndarray = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True, eq=False)
class StackUse:
    """Motion and use of a further stack in a fit.

    Parameters
    ----------
    name : str
    image : Image
    reason : Diagnostic or None
        Why it was not used; None if it was.
    motion : (4, 4) ndarray
        Rigid, RAS mm: takes points of the first image to where this stack shows them, see `to_first`.
    center : (3,) ndarray
        Of the organ in the first image, RAS mm.
    seen : float
        Share of the surface's area that lies in the stack, 0 to 1.
    cost : float
        Mean squared residual along the surface in this stack, in units of its squared contrast; infinite if the stack
        shows no contrast along the surface.
    translation_sd_mm, rotation_sd_degrees : float
        Standard deviations of the displacement of the organ's centre and of its rotation, estimated from the distances
        between the edges of the stacks along the surface; nan if these were not compared.
    """

    name: str
    image: Image
    reason: Diagnostic | None
    motion: np.ndarray
    center: np.ndarray
    seen: float
    cost: float
    translation_sd_mm: float = np.nan
    rotation_sd_degrees: float = np.nan

    @property
    def used(self) -> bool:
        """Whether the surface was fitted to it as well."""
        return self.reason is None

    @property
    def translation_mm(self) -> np.ndarray:
        """Displacement of the organ's centre from the first image to this stack, (3,) mm along R, A and S."""
        return shift_of(self.motion, self.center)

    @property
    def rotation_degrees(self) -> float:
        """Angle of the organ's rotation about its centre from the first image to this stack."""
        return rotation_degrees(self.motion)

    @property
    def to_first(self) -> np.ndarray:
        """Inverse motion, (4, 4): takes the stack to the first image."""
        return np.linalg.inv(self.motion)

    @property
    def stack(self) -> Stack:
        """The stack as input of another fit, which starts with the motion that was found."""
        return Stack(self.image, self.name, self.motion)


def shift_of(motion: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Displacement of a point (3,) by a motion (4, 4), mm."""
    return motion[:3, :3] @ center + motion[:3, 3] - center


def rotation_degrees(motion: np.ndarray) -> float:
    """Angle of the rotation of a rigid motion (4, 4), degrees."""
    cosine = (np.trace(motion[:3, :3]) - 1.0) / 2.0
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def as_stacks(further: Sequence[Stack | Image | str | os.PathLike]) -> tuple[Stack, ...]:
    """Make stacks of stacks, images or paths of images.

    Parameters
    ----------
    further : sequence of Stack, Image or path

    Returns
    -------
    tuple of Stack
        With images that are read, and with names.

    Raises
    ------
    TypeError
        If an item is none of these, or the argument is not a sequence.
    ValueError
        If a file cannot be read as a volume, or a motion is not rigid.
    """
    if isinstance(further, (Stack, Image, str, os.PathLike)):
        msg = "Further stacks are needed as a list, and one was given alone; put it in brackets."
        raise TypeError(msg)
    stacks = []
    for number, given in enumerate(further, start=2):
        stack = given if isinstance(given, Stack) else Stack(given)
        path = stack.image if isinstance(stack.image, (str, os.PathLike)) else None
        name = stack.name or (f"stack {number}" if path is None else Path(path).name)
        stacks.append(Stack(as_image(stack.image), name, _checked_motion(stack.motion)))
    return tuple(stacks)


def stacks_beside(image: Image, further: Sequence[Stack | Image | str | os.PathLike]) -> tuple[Stack, ...]:
    """Make stacks as :func:`as_stacks` does, and refuse a stack that is the first image or was given twice.

    Parameters
    ----------
    image : Image
        The first one.
    further : sequence of Stack, Image or path

    Returns
    -------
    tuple of Stack

    Raises
    ------
    TypeError
        As :func:`as_stacks`.
    ValueError
        As :func:`as_stacks`, or if two images have the same voxels: the standard deviations would be too small.
    """
    stacks = as_stacks(further)
    known = [("the first image", image)]
    for stack in stacks:
        twin = next((name for name, other in known if _same(other, stack.image)), None)
        if twin is not None:
            msg = f"The further stack {stack.name} has the same voxels as {twin}; give each stack once."
            raise ValueError(msg)
        known.append((f"the stack {stack.name}", stack.image))
    return stacks


def _same(one: Image, other: Image) -> bool:
    """Whether two images have the same voxels at the same places, with their axes in any order."""
    if one is other:
        return True
    one, other = one.canonical(), other.canonical()
    placed = one.array.shape == other.array.shape and np.allclose(one.ijk_to_ras, other.ijk_to_ras, atol=_SAME_MM)
    return placed and np.array_equal(one.array, other.array)


def _checked_motion(motion) -> np.ndarray:
    """Return a motion as an array; raise an error if it is not rigid."""
    matrix = np.asarray(motion, dtype=float)
    rigid = (
        matrix.shape == (4, 4)
        and np.isfinite(matrix).all()
        and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-4)
        and np.linalg.det(matrix[:3, :3]) > 0.0
        and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
    )
    if not rigid:
        msg = f"The motion {matrix.tolist()} of a stack is not rigid; give a 4 x 4 matrix of a turn and a shift, mm."
        raise ValueError(msg)
    return matrix
