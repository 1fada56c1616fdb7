"""A model of two organs, and stacks of both in two directions, each organ moved by its own motion in the second one."""

from __future__ import annotations

import numpy as np
from small_phantom import CENTER, ellipsoid
from stack_phantom import dented, motion_about, stack_of

from VICRegistrationLib.multipatch.cuts import OrganCuts
from VICRegistrationLib.multipatch.drawing import Drawing

# Along no axis of the organs: half a turn about the line between them is another pose.
APART = np.array([42.0, 14.0, 16.0])
CENTERS = {"bladder": CENTER, "vagina": CENTER + APART}
SEEDS = {name: center[None] for name, center in CENTERS.items()}
SHIFTS = {"bladder": (2.0, -1.5, 1.5), "vagina": (0.5, 1.0, -1.0)}
SIZES = {"sagittal": (66, 70, 25), "axial": (88, 66, 21)}


def placed(surface, name):
    """Move a surface to the place of an organ."""
    matrix = np.eye(4)
    matrix[:3, 3] = CENTERS[name] - CENTER
    return surface.transformed(matrix)


def truth():
    """Dented organs in the first stack."""
    return {name: placed(dented(), name) for name in CENTERS}


def motions():
    return {name: motion_about(CENTERS[name], shift, (1.0, -1.0, 1.5)) for name, shift in SHIFTS.items()}


def stack(direction, *, moved=False, filling=1.0):
    """Paint both organs, the bladder so many times as large."""
    surfaces = truth()
    net = surfaces["bladder"].control_net
    surfaces["bladder"] = surfaces["bladder"].with_control_net(CENTER + filling * (net - CENTER))
    if moved:
        surfaces = {name: surface.transformed(motions()[name]) for name, surface in surfaces.items()}
    center = CENTER + APART / 2.0
    return stack_of(list(surfaces.values()), direction, size=SIZES[direction], center=center, seed=2)


def two_organs():
    """Their model: ellipsoids."""
    return drawing_of({name: placed(ellipsoid(), name) for name in CENTERS}).model(name="two organs", landmarks={})


def with_a_third_organ():
    """The same with an organ, a sheet and a place on bone that the stacks do not show."""
    parents = {name: placed(ellipsoid(), name) for name in CENTERS}
    matrix = np.eye(4)
    matrix[:3, 3] = (0.0, -60.0, 0.0)
    drawing = drawing_of({**parents, "rectum": parents["bladder"].transformed(matrix)})
    ends = [CENTERS["vagina"] + (20.0, -40.0, height) for height in (-20.0, 20.0)]
    drawing.sheet("band", drawing.border("vagina back", "u_max"), ends)
    return drawing.model(name="three organs", landmarks={"peg": CENTER + (0.0, -30.0, 30.0)})


def drawing_of(parents):
    cuts = {name: OrganCuts([0, 0.5], [0, 1], [[f"{name} front"], [f"{name} back"]]) for name in parents}
    return Drawing(parents, cuts)
