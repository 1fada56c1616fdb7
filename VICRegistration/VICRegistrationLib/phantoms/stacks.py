"""Further stacks of the synthetic pelvis, in other directions, after the patient has moved."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import write_json
from ..geometry.parametrization import rigid_matrix
from ..imaging.image import Image
from ..imaging.reading import write_image
from .pelvis import pelvis_phantom

DIRECTIONS = ("axial", "coronal")
# Centre of the patient's rotation, about the middle of the organs, RAS mm.
_CENTER = np.array([1.0, 8.0, 6.0])
# Fewer pixels and more slices than the sagittal stack has, because the organs are longer than wide.
_SIZE, _SLICES = (384, 384), 44


@dataclass(frozen=True, eq=False)
class PhantomStack:
    """A further stack with the true motion.

    Parameters
    ----------
    direction : {"axial", "coronal"}
    image : Image
    motion : (4, 4) ndarray
        Rigid, RAS mm: maps points of the first stack to this one.
    """

    direction: str
    image: Image
    motion: np.ndarray


def further_stacks(
    count: int, *, seed: int = 0, shift_mm: float = 0.0, turn_degrees: float = 0.0, **choices
) -> list[PhantomStack]:
    """Paint further stacks of the pelvis, each with its own texture, noise and motion.

    Parameters
    ----------
    count : int
        0 to 2: axial, then coronal.
    seed : int
        Seed of the first stack; those of the others follow from it.
    shift_mm, turn_degrees : float
        Translation and rotation of the patient before each of them, in a random direction and about a random axis.
    **choices
        As for :func:`.pelvis.pelvis_phantom`.

    Returns
    -------
    list of PhantomStack
    """
    rng = np.random.default_rng([seed, 17])
    stacks = []
    for number, direction in enumerate(DIRECTIONS[:count], start=1):
        shift, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        motion = rigid_matrix(np.append(np.radians(turn_degrees) * axis, shift_mm * shift), _CENTER)
        own = {"size": _SIZE, "n_slices": _SLICES, **choices}
        phantom = pelvis_phantom(seed=seed + 1000 * number, direction=direction, motion=motion, **own)
        stacks.append(PhantomStack(direction, phantom.image, motion))
    return stacks


def write_stacks(stacks: Sequence[PhantomStack], directory: str | os.PathLike) -> list[str]:
    """Write further stacks as ``mri_DIRECTION.nii.gz``, and their motions as ``truth/motion.json``.

    Parameters
    ----------
    stacks : sequence of PhantomStack
    directory : path
        Is made if it does not exist.

    Returns
    -------
    list of str
        Names of the images' files.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    if not stacks:
        return []
    truth = Path(directory) / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    names = [f"mri_{stack.direction}.nii.gz" for stack in stacks]
    for name, stack in zip(names, stacks):
        write_image(stack.image, Path(directory) / name)
    motions = {name: stack.motion.tolist() for name, stack in zip(names, stacks)}
    write_json(truth / "motion.json", motions)
    return names
