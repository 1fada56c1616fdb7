"""The demonstration's table; the whole of it is what ``make demo`` runs."""

from __future__ import annotations

import dataclasses

import pytest
from needs_gmsh import gmsh_or_skip
from small_phantom import CENTER, ellipsoid, ellipsoid_image

from VICRegistrationLib import demo
from VICRegistrationLib.cli.configuration import organ_request
from VICRegistrationLib.cli.fitting import fit_to_folder
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.meshing import process
from VICRegistrationLib.phantoms import pelvis

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "small_pictures")


@pytest.fixture(scope="module")
def organs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("organs")
    write_image(ellipsoid_image(), folder / "mri.nrrd")
    requests = [organ_request("bladder", [CENTER])]
    return fit_to_folder(folder / "mri.nrrd", requests, folder / "out", pictures=False).organs


def test_the_table_shows_deviation_volume_and_time(organs):
    titles, units, row = demo.deviation_table(organs, {"bladder": ellipsoid()}).splitlines()
    assert titles.split() == ["organ", "mean", "signed", "95", "%", "largest", "volume", "truth", "time"]
    assert units.split() == ["mm"] * 4 + ["ml"] * 2 + ["s"]
    name, *numbers = row.split()
    assert name == "bladder"
    mean, signed, p95, largest, volume, truth, seconds = map(float, numbers)
    assert abs(signed) <= mean <= p95 <= largest < 2.0
    assert volume == pytest.approx(truth, rel=0.05)
    assert seconds > 0.0


def test_the_demonstration_ends_with_a_picture_to_open(tmp_path, monkeypatch, capsys):
    whole = pelvis.pelvis_phantom

    def bladder_only():
        """Coarser pixels and one organ: the same way in a fraction of the time."""
        phantom = whole(spacing=(1.5, 1.5, 4.0), size=(150, 150))
        return dataclasses.replace(
            phantom,
            surfaces={"bladder": phantom.surfaces["bladder"]},
            seeds={"bladder": phantom.seeds["bladder"]},
        )

    monkeypatch.setattr(demo, "pelvis_phantom", bladder_only)
    monkeypatch.setattr(demo, "MESH_SIZE_MM", 6.0)
    assert demo.main([str(tmp_path / "demo")]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    picture = tmp_path / "demo" / "organs" / "bladder.png"
    assert last == f"Open this picture: {picture}"
    assert picture.exists()
    assert (tmp_path / "demo" / "phantom" / "truth" / "bladder.json").exists()
    assert (tmp_path / "demo" / "organs" / "bladder.step").read_text(encoding="ascii").startswith("ISO-10303-21;")


def test_the_mesh_of_the_demonstration_is_written_and_drawn(organs, tmp_path, monkeypatch, capsys):
    gmsh_or_skip()
    monkeypatch.setattr(demo, "MESH_SIZE_MM", 6.0)
    demo._write_mesh(organs, tmp_path / "mesh")
    written = sorted(path.name for path in (tmp_path / "mesh").iterdir())
    assert written == ["organs.msh", "organs.png", "organs.quality.json", "organs.vtu"]
    assert "0 inverted" in capsys.readouterr().out


def test_without_gmsh_the_demonstration_says_how_to_get_it(organs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(process.importlib.util, "find_spec", lambda name: None)
    demo._write_mesh(organs, tmp_path / "mesh")
    assert not (tmp_path / "mesh").exists()
    assert "pip install gmsh" in capsys.readouterr().out


def test_a_folder_that_cannot_be_made_ends_with_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(demo, "pelvis_phantom", lambda: None)
    (tmp_path / "file").write_text("")
    assert demo.main([str(tmp_path / "file")]) == 2
    assert capsys.readouterr().err.startswith("demo: error: ")
