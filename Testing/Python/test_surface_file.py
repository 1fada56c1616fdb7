"""Surface files: nothing is lost in them, and everything else is refused by name."""

from __future__ import annotations

import json

import numpy as np
import pytest

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.surface_file import read_surface, read_surface_record, write_surface


@pytest.fixture
def organ():
    surface = models.closed_organ(axes=np.diag([31.7, 28.1, 44.9]), center=(-12.3, 45.6, 1e-7))
    return surface.with_control_net(surface.control_net * (1.0 + 1e-15))


@pytest.fixture
def path(organ, tmp_path):
    """A file that is right in all points."""
    path = tmp_path / "bladder.json"
    write_surface(organ, path, name="bladder", net="9x7", closure="smooth")
    return path


def changed(path, **changes):
    """Rewrite a file with some keys replaced, or removed where the value is None."""
    content = json.loads(path.read_text(encoding="utf-8"))
    content.update(changes)
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    return path


def test_a_surface_comes_back_to_the_last_bit(organ, path):
    surface = read_surface(path)
    assert surface.degrees == organ.degrees
    for name in ("knots_u", "knots_v", "control_net"):
        np.testing.assert_array_equal(getattr(surface, name), getattr(organ, name))


def test_extreme_numbers_come_back_to_the_last_bit(tmp_path):
    net = np.array([0.1 + 0.2, 5e-324, -0.0, 99999.99999999999, 1.0 / 3.0, -np.pi] * 2).reshape(2, 2, 3)
    surface = BSplineSurface((1, 1), [0, 0, 1 / 3, 1 / 3], [-1e-300, 0, 0.7, 0.7], net)
    write_surface(surface, tmp_path / "extreme.json")
    back = read_surface(tmp_path / "extreme.json")
    assert back.control_net.tobytes() == surface.control_net.tobytes()
    assert back.knots_v.tobytes() == surface.knots_v.tobytes()


@pytest.mark.parametrize("factor", [1e4, 1e200])
def test_a_surface_where_no_body_is_is_refused(organ, tmp_path, factor):
    write_surface(organ.with_control_net(organ.control_net * factor), tmp_path / "far.json")
    with pytest.raises(ValueError, match=r"far\.json holds no surface: a control point has .* no body lies farther"):
        read_surface(tmp_path / "far.json")


def test_name_net_and_closure_come_back_with_the_surface(path):
    record = read_surface_record(path)
    assert (record.name, record.net, record.closure) == ("bladder", "9x7", "smooth")


def test_name_net_and_closure_may_be_empty_and_a_name_may_be_of_any_alphabet(organ, tmp_path):
    write_surface(organ, tmp_path / "a.json")
    record = read_surface_record(tmp_path / "a.json")
    assert (record.name, record.net, record.closure) == ("", "", "")
    write_surface(organ, tmp_path / "b.json", name='Blase "links" 膀胱')
    assert read_surface_record(tmp_path / "b.json").name == 'Blase "links" 膀胱'


def test_the_file_follows_its_documented_schema(organ, path):
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["schema"] == "vic-registration/surface"
    assert content["version"] == 1
    assert (content["frame"], content["unit"]) == ("RAS", "mm")
    assert content["degrees"] == [3, 3]
    assert content["control_net"][2][1] == organ.control_net[2, 1].tolist()
    assert len(content["knots_u"]) == len(content["control_net"]) + 4
    assert len(content["knots_v"]) == len(content["control_net"][0]) + 4


def test_keys_of_later_use_are_ignored(organ, path):
    changed(path, color=[1, 0, 0])
    np.testing.assert_array_equal(read_surface(path).control_net, organ.control_net)


# ------------------------------------------------------------------ writing


def test_a_file_is_replaced_in_one_step_and_nothing_is_left_beside_it(organ, path):
    write_surface(organ, path, name="vagina")
    assert read_surface_record(path).name == "vagina"
    assert [file.name for file in path.parent.iterdir()] == ["bladder.json"]


def test_a_folder_that_does_not_exist_is_named_in_one_line(organ, tmp_path):
    target = tmp_path / "nowhere" / "a.json"
    with pytest.raises(
        OSError, match=r"a\.json cannot be written \(No such file or directory\); choose a folder"
    ) as caught:
        write_surface(organ, target)
    assert "\n" not in str(caught.value)
    assert str(target) in str(caught.value)


def test_a_failed_writing_leaves_what_was_there(organ, tmp_path):
    target = tmp_path / "a.json"
    target.mkdir()
    (target / "keep").write_text("kept")
    with pytest.raises(OSError, match="cannot be written"):
        write_surface(organ, target)
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]
    assert (target / "keep").read_text() == "kept"


# ------------------------------------------------------------------ refusals


def refusal(path):
    """The sentence with which a file is refused; it names the file and is one line."""
    with pytest.raises(ValueError, match=r".") as caught:
        read_surface(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(
        OSError, match=r"none\.json cannot be read \(No such file or directory\); give a file that exists"
    ):
        read_surface(tmp_path / "none.json")


@pytest.mark.parametrize(
    "content", [b"", b"{", b"solid bladder", b"\xff\xfe\x00", b"\x89PNG\r\n", b"[" * 100000], ids=range(6)
)
def test_what_is_not_json_is_refused(path, content):
    path.write_bytes(content)
    assert "is not valid JSON" in refusal(path)


@pytest.mark.parametrize("content", ["[]", "3", "null", "{}", '{"schema": "other"}'])
def test_json_of_another_kind_is_refused(path, content):
    path.write_text(content)
    assert '"schema": "vic-registration/surface" is needed, give a surface file' in refusal(path)


@pytest.mark.parametrize("version", [0, 2, "1", True, 1.5])
def test_other_versions_are_refused_with_the_one_that_is_understood(path, version):
    message = refusal(changed(path, version=version))
    assert f"has version {version!r}; version 1 is understood, update the program" in message


@pytest.mark.parametrize(("key", "value", "needed"), [("frame", "LPS", "RAS"), ("unit", "m", "mm")])
def test_another_frame_or_unit_is_refused(path, key, value, needed):
    message = refusal(changed(path, **{key: value}))
    assert f"has the {key} {value!r}; convert the surface to {needed!r}" in message


@pytest.mark.parametrize(
    "key", ["name", "frame", "unit", "net", "closure", "degrees", "knots_u", "knots_v", "control_net"]
)
def test_a_missing_key_is_named(path, key):
    assert f"lacks {key};" in refusal(changed(path, **{key: None}))


@pytest.mark.parametrize("key", ["name", "net", "closure"])
def test_texts_that_are_none_are_refused(path, key):
    assert f"has a {key} that is not text" in refusal(changed(path, **{key: 7}))


def test_a_ragged_control_net_is_refused(path):
    net = json.loads(path.read_text(encoding="utf-8"))["control_net"]
    assert "is ragged; give rows of equal length" in refusal(changed(path, control_net=[net[0][:-1], *net[1:]]))
    net[2][3] = net[2][3][:2]
    assert "three coordinates per point" in refusal(changed(path, control_net=net))


@pytest.mark.parametrize("net", [3, [], {}, [1, 2], [[1, 2], [3, 4]], "net", [None]])
def test_a_control_net_without_rows_of_points_is_refused(path, net):
    assert "is not made of rows of points [r, a, s]" in refusal(changed(path, control_net=net))


@pytest.mark.parametrize("bad", ["NaN", "Infinity", "-Infinity"])
def test_numbers_that_are_not_finite_are_refused(path, bad):
    text = path.read_text(encoding="utf-8")
    start = text.index("[[[") + 3
    path.write_text(text[:start] + bad + text[text.index(",", start) :])
    assert f"{bad} is not a number" in refusal(path)


def test_numbers_beyond_the_range_of_doubles_are_refused(path):
    text = path.read_text(encoding="utf-8")
    start = text.index("[[[") + 3
    path.write_text(text[:start] + "1e999" + text[text.index(",", start) :])
    assert "points that are not finite" in refusal(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"degrees": [3]}, "has the degrees [3]; give two whole numbers"),
        ({"degrees": [3.0, 3]}, "has the degrees [3.0, 3]; give two whole numbers"),
        ({"degrees": [3, 0]}, "Degree 0 was given"),
        ({"degrees": [3, "3"]}, "The degrees of"),
        ({"degrees": 3}, "The degrees of"),
        ({"degrees": [2, 3]}, "the degrees and knots need"),
        ({"knots_u": [0, 0, 0, 0, 1, 1, 1, 1]}, "the degrees and knots need"),
        ({"knots_v": [0, 0, 0, 0, 0.6, 0.5, 0.75, 1, 1, 1, 1]}, "decrease somewhere"),
        ({"knots_v": [0, True]}, "The knots v of"),
        ({"knots_v": [0, [1]]}, "The knots v of"),
    ],
)
def test_parts_that_make_no_surface_are_refused(path, changes, message):
    assert message in refusal(changed(path, **changes))
