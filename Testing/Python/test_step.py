"""STEP files as text: well formed, the same every time, and refused for what is no solid."""

from __future__ import annotations

import re

import numpy as np
import pytest
from step_organs import dented, organ

from VICRegistrationLib.export.step import Solid, step_text, write_step
from VICRegistrationLib.export.step_shapes import patches, real, string
from VICRegistrationLib.frames import RAS_TO_LPS
from VICRegistrationLib.geometry.bspline import uniform_clamped_knots
from VICRegistrationLib.geometry.models import bell
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.phantoms.organs import Tube, organ_surface

QUOTED = re.compile(r"'(?:[^']|'')*'")


def instances(text):
    """Numbered instances of the data section."""
    data = text[text.index("DATA;\n") + 6 : text.index("ENDSEC;\nEND-ISO-10303-21;")]
    return dict(re.findall(r"^(#\d+)=(.*);$", data, re.MULTILINE))


@pytest.fixture
def pair():
    return [Solid("left", organ(), (1.0, 0.5, 0.0)), Solid("right", organ(closure="paper"))]


# ------------------------------------------------------------------ text


@pytest.mark.parametrize("faces", [1, 4])
@pytest.mark.parametrize("number", [1, 2])
def test_every_reference_leads_to_an_instance_and_no_shape_is_left_over(pair, faces, number):
    found = instances(step_text(pair[:number], faces=faces))
    assert list(found) == [f"#{number}" for number in range(1, len(found) + 1)]
    used = {reference for value in found.values() for reference in re.findall(r"#\d+", QUOTED.sub("", value))}
    assert used <= set(found)
    # Nothing refers to these; everything else is there because something needs it.
    tops = (
        "APPLICATION_PROTOCOL_DEFINITION",
        "PRODUCT_RELATED_PRODUCT_CATEGORY",
        "SHAPE_DEFINITION_REPRESENTATION",
        "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION",
        "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION",
    )
    assert [found[number] for number in found if number not in used and not found[number].startswith(tops)] == []


def test_the_file_says_what_it_holds(pair):
    text = step_text(pair)
    assert text.startswith("ISO-10303-21;\nHEADER;\n")
    assert text.endswith("ENDSEC;\nEND-ISO-10303-21;\n")
    for words in ("left, right", "LPS mm", "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"):
        assert words in text
    found = list(instances(text).values())
    assert found.count("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))") == 1
    assert sum(value.startswith("MANIFOLD_SOLID_BREP") for value in found) == 2
    assert sum(value.startswith("NEXT_ASSEMBLY_USAGE_OCCURRENCE") for value in found) == 2
    assert sum(value.startswith("STYLED_ITEM") for value in found) == 1


def test_control_points_and_knots_are_in_the_text_to_the_last_bit():
    surface = dented().insert_knots(u=[1.0 / 3.0], v=[2.0 / 3.0])
    found = instances(step_text([Solid("left", surface)]))
    (text,) = (value for value in found.values() if value.startswith("B_SPLINE_SURFACE_WITH_KNOTS"))
    points = [found[reference].partition("(")[2] for reference in re.findall(r"#\d+", text)]
    net = [[float(number) for number in re.findall(r"[-+.\dE]+", point)] for point in points]
    np.testing.assert_array_equal(net, (surface.control_net * RAS_TO_LPS).reshape(-1, 3))
    lists = [re.findall(r"[-+.\dE]+", part) for part in re.findall(r"\(([^()#]+)\)", text)]
    for knots, counts, values in zip((surface.knots_u, surface.knots_v), lists[:2], lists[2:]):
        np.testing.assert_array_equal(np.repeat([float(value) for value in values], np.array(counts, dtype=int)), knots)


@pytest.mark.parametrize("faces", [1, 2, 5])
def test_every_edge_is_passed_once_in_each_sense(faces):
    """Without it a solid is no closed one; Open CASCADE mends that without a word."""
    found = instances(step_text([Solid("left", organ())], faces=faces)).values()
    passed = [re.match(r"ORIENTED_EDGE\('',\*,\*,(#\d+),(\.[TF]\.)\)", value) for value in found]
    senses = [match.groups() for match in passed if match]
    assert len(senses) == len(set(senses)) == 2 * faces
    assert len({edge for edge, _ in senses}) == faces


def test_the_same_organs_give_the_same_bytes(pair, tmp_path):
    for name in ("a", "b"):
        write_step(pair, tmp_path / f"{name}.step", faces=3)
    assert (tmp_path / "a.step").read_bytes() == (tmp_path / "b.step").read_bytes()


def test_a_file_is_ascii_with_its_lines_ended(pair, tmp_path):
    write_step([Solid("Größe 膀胱", organ())], tmp_path / "a.step")
    content = (tmp_path / "a.step").read_bytes()
    assert max(content) < 128
    assert b"'Gr\\X2\\00F600DF\\X0\\e \\X2\\818080F1\\X0\\'" in content


@pytest.mark.parametrize(
    "number", [0.0, 1.0, -2.0, 0.1, 1e-5, -1.5e-7, 1e16, 1.2345e300, 5e-324, np.pi, 1 / 3, np.float64(0.1)]
)
def test_a_number_is_written_as_part_21_wants_it_and_comes_back(number):
    assert re.fullmatch(r"[+-]?\d+\.\d*(E[+-]?\d+)?", real(number))
    assert float(real(number)) == number


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_not_written(number):
    with pytest.raises(ValueError, match="give finite numbers"):
        real(number)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("bladder", "'bladder'"),
        ("", "''"),
        ("d'A", "'d''A'"),
        ("a\\b", "'a\\\\b'"),
        ("é", r"'\X2\00E9\X0\'"),
        ("éa", r"'\X2\00E9\X0\a'"),
        ("\n", r"'\X2\000A\X0\'"),
        ("é😀", r"'\X4\000000E90001F600\X0\'"),
        ("\udc80", r"'\X2\FFFD\X0\'"),
    ],
)
def test_a_text_is_written_as_part_21_wants_it(text, expected):
    assert string(text) == expected


# ------------------------------------------------------------------ patches


@pytest.mark.parametrize("number", [1, 2, 3, 8, 13, 40])
def test_strips_are_the_same_surface(number):
    surface = dented()
    strips = patches(surface, number)
    assert len(strips) == number
    assert strips[0].domain[0][0] == surface.domain[0][0]
    assert strips[-1].domain[0][1] == surface.domain[0][1]
    for strip in strips:
        (low, high), (v_low, v_high) = strip.domain
        u, v = np.linspace(low, high, 7), np.linspace(v_low, v_high, 31)
        # Rounding of Boehm's algorithm, on coordinates of up to 80 mm.
        np.testing.assert_allclose(strip.grid(u, v), surface.grid(u, v), atol=1e-12)


def test_strips_share_their_edges_to_the_last_bit():
    strips = patches(dented(), 5)
    for strip, following in zip(strips, strips[1:]):
        assert strip.domain[0][1] == following.domain[0][0]
        np.testing.assert_array_equal(strip.control_net[-1], following.control_net[0])
    np.testing.assert_array_equal(strips[-1].control_net[-1], strips[0].control_net[0])


def test_a_single_strip_is_the_surface_itself():
    surface = dented()
    (strip,) = patches(surface)
    np.testing.assert_array_equal(strip.control_net, surface.control_net)
    np.testing.assert_array_equal(strip.knots_u, surface.knots_u)
    np.testing.assert_array_equal(strip.knots_v, surface.knots_v)


def test_cuts_lie_at_knots_where_there_are_enough():
    surface = organ((9, 7))
    assert [strip.domain[0][0] for strip in patches(surface, 4)] == [0.0, 0.25, 0.5, 0.75]
    assert [strip.domain[0][0] for strip in patches(surface, 3)] == [0.0, 0.375, 0.625]
    assert len({strip.domain[0][0] for strip in patches(surface, 100)}) == 100


def test_knots_that_are_not_clamped_are_clamped():
    clamped = organ((9, 7))
    period = np.arange(-3, 12) / 8.0
    angle = 2.0 * np.pi * np.arange(11) / 8.0
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(11)], axis=1)
    radius, height = np.array([0.0, 20.0, 20.0, 0.0]), np.array([-9.0, -9.0, 9.0, 9.0])
    net = ring[:, None] * radius[:, None] + height[:, None] * [0.0, 0.0, 1.0]
    surface = BSplineSurface((3, 3), period, uniform_clamped_knots(3, 4), net)
    (strip,) = patches(surface)
    assert strip.control_net.shape[0] == clamped.control_net.shape[0]
    np.testing.assert_array_equal(strip.knots_u, clamped.knots_u)
    u, v = np.linspace(0.0, 1.0, 33), np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(strip.grid(u, v), surface.grid(u, v), atol=1e-13)


@pytest.mark.parametrize("number", [0, -1, 2.5])
def test_a_number_of_faces_that_is_none_is_refused(number):
    with pytest.raises(ValueError, match=r"left: .* faces were asked for; give a whole number of at least 1"):
        step_text([Solid("left", organ())], faces=number)


# ------------------------------------------------------------------ refusals


def folded_pole():
    """Turn the ring next to the second pole over: it goes round backwards."""
    net = np.array(organ().control_net)
    net[:, -2] = 2.0 * net[:, -1] - net[:, -2]
    net[3:6, -2] = net[:1, -1] + 0.3 * (net[7:8, -2] - net[:1, -1])
    return organ().with_control_net(net)


def folded():
    """Crumple a side: its control points change places."""
    net = np.array(organ((17, 13)).control_net)
    net[4:13, 4:9] += np.random.default_rng(0).normal(0.0, 9.0, (9, 5, 3))
    return organ((17, 13)).with_control_net(net)


def crossing():
    """Bend a tube so that its ends run through each other."""
    axis = ((0.0, 0.0, 0.0), (0.0, 60.0, 0.0), (60.0, 0.0, 30.0), (0.0, -60.0, 0.0))
    return organ_surface(Tube(axis=axis, lateral=(12.0,), sagittal=(12.0,)))


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        (bell(30.0), r"bladder: The surface has a rim at R .*, A .*, S .* mm \(u .*, v 0\)\. A solid needs"),
        (folded_pole(), r"bladder: The pole at R .*, A .*, S .* mm \(u .*, v 1\) is folded"),
        (
            organ().with_control_net(organ().control_net[::-1]),
            r"bladder: The surface is inside out: its normal at R .* mm \(u .*\) points inward\. Reverse",
        ),
        (folded(), r"bladder: The surface is folded over at R .*, A .*, S .* mm \(u .*, v .*\)\. Take"),
        (crossing(), r"bladder: The surface passes through itself at R .*, A .*, S .* mm \(u .*, v .*\), where"),
    ],
    ids=["bell", "folded pole", "inside out", "folded", "self-intersection"],
)
def test_a_surface_that_bounds_no_solid_is_refused_with_the_place(surface, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        write_step([Solid("left", organ()), Solid("bladder", surface)], tmp_path / "a.step")
    assert list(tmp_path.iterdir()) == []


def test_a_ring_is_refused():
    knots = uniform_clamped_knots(1, 5)
    angle = 2.0 * np.pi * np.array([0, 1, 2, 3, 0]) / 4.0
    cos, sin = np.cos(angle), np.sin(angle)
    across = np.stack([cos, np.zeros(5)], axis=1)
    net = np.stack([np.outer(cos, 3.0 + across[:, 0]), np.outer(sin, 3.0 + across[:, 0]), np.tile(sin, (5, 1))], axis=2)
    with pytest.raises(ValueError, match=r"ring: The surface is open or a ring; a solid needs a seam in u and a pole"):
        step_text([Solid("ring", BSplineSurface((1, 1), knots, knots, net))])


def test_a_surface_torn_at_a_knot_is_refused():
    surface = organ(degrees=(1, 1))
    knot = surface.knots_u[3]
    torn = surface.insert_knots(u=[knot])
    with pytest.raises(ValueError, match=rf"torn: The knot {knot:g} has a multiplicity above the degree 1"):
        step_text([Solid("torn", torn)])


def test_no_organ_or_two_of_one_name_are_refused():
    with pytest.raises(ValueError, match="No organ was given"):
        step_text([])
    with pytest.raises(ValueError, match="Two organs are named 'left'; rename one"):
        step_text([Solid("left", organ()), Solid("left", organ())])


@pytest.mark.parametrize("color", [(1.0, 0.5), (1.0, 2.0, 0.0), (np.nan, 0.0, 0.0), (-0.1, 0.0, 0.0)])
def test_a_colour_that_is_none_is_refused(color):
    with pytest.raises(ValueError, match=r"left: The colour .* was given; give red, green and blue from 0 to 1"):
        step_text([Solid("left", organ(), color)])


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path):
    with pytest.raises(OSError, match=r"a\.step cannot be written"):
        write_step([Solid("left", organ())], tmp_path / "none" / "a.step")
    assert list(tmp_path.iterdir()) == []
