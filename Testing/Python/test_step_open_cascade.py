"""Open CASCADE reads what is written as valid closed solids, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from step_organs import dented, organ

from VICRegistrationLib.export.step import Solid, write_step
from VICRegistrationLib.export.step_shapes import patches
from VICRegistrationLib.frames import RAS_TO_LPS
from VICRegistrationLib.phantoms.organs import pelvic_organs

pytest.importorskip("OCP", reason="Open CASCADE (cadquery-ocp-novtk) is not installed")
occ = pytest.importorskip("open_cascade")

# The closed organ is the only generic model that is closed; the bell is refused in test_step.py.
NETS = [(9, 7), (17, 13), (33, 25)]
CLOSURES = ["smooth", "paper"]


@pytest.fixture
def written(tmp_path):
    """Write organs and read their shape back."""

    def write(*solids, **kwargs):
        write_step(solids, tmp_path / "a.step", **kwargs)
        return occ.read(tmp_path / "a.step")

    return write


def check_solid(shape, surface):
    assert occ.is_valid(shape)
    assert occ.is_closed(shape)
    assert (len(occ.solids(shape)), len(occ.shells(shape))) == (1, 1)
    assert occ.volume(shape) == pytest.approx(surface.volume(), rel=1e-6)
    # Open CASCADE's smallest: nothing had to be stretched to meet.
    assert occ.largest_tolerance(shape) <= 1.01e-7


def check_patch(found, surface):
    """Degrees, control points in LPS and knots; a closed patch has become a periodic one, without its last row."""
    rows = surface.control_net[:-1] if found.periodic else surface.control_net
    assert found.degrees == surface.degrees
    np.testing.assert_array_equal(found.poles, rows * RAS_TO_LPS)
    for axis, knots in enumerate((surface.knots_u, surface.knots_v)):
        values, counts = np.unique(knots, return_counts=True)
        if axis == 0 and found.periodic:
            counts[[0, -1]] -= 1
        np.testing.assert_array_equal(found.knots[axis], values)
        np.testing.assert_array_equal(found.multiplicities[axis], counts)


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("net", NETS, ids=str)
def test_one_face_with_a_seam_is_a_valid_solid_to_the_last_bit(written, net, closure):
    surface = organ(net, closure=closure)
    shape = written(Solid("bladder", surface))
    check_solid(shape, surface)
    (face,) = occ.faces(shape)
    check_patch(occ.patch(face), surface)
    assert occ.n_seams(shape) == 1


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("number", [2, 5])
def test_several_faces_are_a_valid_solid_without_a_seam(written, closure, number):
    surface = organ((17, 13), closure=closure)
    shape = written(Solid("bladder", surface), faces=number)
    check_solid(shape, surface)
    assert occ.n_seams(shape) == 0
    faces = occ.faces(shape)
    assert len(faces) == number
    for face, strip in zip(faces, patches(surface, number)):
        found = occ.patch(face)
        assert not found.periodic
        check_patch(found, strip)


@pytest.mark.parametrize(("closure", "number"), [("smooth", 1), ("paper", 3), ("smooth", 7)])
@pytest.mark.parametrize("degrees", [(1, 1), (2, 2), (2, 3), (3, 2), (4, 3), (5, 5)], ids=str)
def test_other_degrees_are_valid_solids_to_the_last_bit(written, degrees, closure, number):
    surface = organ((9, 7), closure=closure, degrees=degrees)
    shape = written(Solid("bladder", surface), faces=number)
    check_solid(shape, surface)
    for face, strip in zip(occ.faces(shape), patches(surface, number)):
        check_patch(occ.patch(face), strip)


@pytest.mark.parametrize("number", [1, 4, 13])
def test_a_dent_and_uneven_knots_are_kept(written, number):
    surface = dented()
    shape = written(Solid("bladder", surface), faces=number)
    check_solid(shape, surface)
    for face, strip in zip(occ.faces(shape), patches(surface, number)):
        check_patch(occ.patch(face), strip)


@pytest.mark.parametrize("number", [1, 4])
def test_three_organs_are_an_assembly_of_named_and_coloured_parts(tmp_path, number):
    organs = pelvic_organs()
    colors = {"bladder": (0.96, 0.72, 0.18), "vagina": (0.0, 0.5, 1.0), "rectum": None}
    solids = [Solid(name, surface, colors[name]) for name, surface in organs.items()]
    write_step(solids, tmp_path / "a.step", faces=number)
    shape = occ.read(tmp_path / "a.step")
    assert occ.is_valid(shape)
    assert occ.is_closed(shape)
    for solid, surface in zip(occ.solids(shape), organs.values()):
        check_solid(solid, surface)
        assert len(occ.faces(solid)) == number
    assembly, *parts = occ.parts(tmp_path / "a.step")
    assert (assembly.name, assembly.components) == ("organs", tuple(organs))
    assert [part.name for part in parts] == list(organs)
    for part in parts:
        expected = colors[part.name]
        # Colours are held in single precision.
        assert part.color == (expected if expected is None else pytest.approx(expected, abs=1e-6))


@pytest.mark.parametrize("name", ["bladder", "Größe", "d'Artagnan's \"bladder\" \\ 1", "膀胱 é", "a 😀 b", "a\nb", ""])
def test_a_name_comes_back_whatever_its_letters(tmp_path, name):
    write_step([Solid(name, organ(), (0.2, 0.4, 0.6))], tmp_path / "a.step")
    (part,) = occ.parts(tmp_path / "a.step")
    assert part.name == name
    assert part.color == pytest.approx((0.2, 0.4, 0.6), abs=1e-6)


def test_the_unit_is_the_millimetre(tmp_path):
    from OCP.Interface import Interface_Static

    write_step([Solid("bladder", organ())], tmp_path / "a.step")
    before = Interface_Static.CVal_s("xstep.cascade.unit")
    try:
        # A reader that works in metres has to convert.
        assert Interface_Static.SetCVal_s("xstep.cascade.unit", "M")
        shape = occ.read(tmp_path / "a.step")
    finally:
        Interface_Static.SetCVal_s("xstep.cascade.unit", before)
    (face,) = occ.faces(shape)
    np.testing.assert_allclose(occ.patch(face).poles * 1000.0, organ().control_net[:-1] * RAS_TO_LPS, rtol=1e-14)
