"""The report: one page that needs nothing else, and tells all that there is to tell and nothing that there is not."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
from datetime import datetime, timedelta, timezone
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from quick_fits import compare_few_points, without_finer_nets, without_shapes
from small_phantom import CENTER, SEED, ellipsoid, ellipsoid_image

from VICRegistrationLib import cli
from VICRegistrationLib.analysis.references import ReadReference
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.choices import Choice
from VICRegistrationLib.report.contents import ReportedOrgan, Source, compared_organ
from VICRegistrationLib.report.page import orientation_text, report_html, volume_text

matplotlib = pytest.importorskip("matplotlib", reason="pictures need matplotlib")
pytest.importorskip("jinja2", reason="the page needs Jinja2")

VOID = {"img", "meta", "link", "br", "hr", "input", "col"}
WARNINGS = [
    "The surface follows no edge on 12 % of its area, mostly at the lower pole.",
    "The organ reaches the border of the image (left & inferior) and may go on outside of it.",
]
DATE = datetime(2026, 3, 1, 12, 30, tzinfo=timezone(timedelta(hours=1)))
NASTY = "<b>&\"'ü \U0001f600"


class Confidence:
    """The surface is surer of its lower than of its upper end."""

    volume_sd_ml = 0.42
    unsupported_share = 0.03
    volume_calibrated = True
    deviations = np.array([[0.1, 0.2], [0.3, 0.5]])
    areas = np.array([[40.0, 20.0], [30.0, 10.0]])

    def standard_deviation(self, parameters):
        """0.1 mm at one pole, 0.5 mm at the other."""
        return 0.1 + 0.4 * np.asarray(parameters)[:, 1]


class Page(HTMLParser):
    """Elements, their order, and the text of a page; complains of tags that do not match."""

    def __init__(self, content):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.words = [], [], []
        self.feed(content)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style" and data.strip():
            self.words.append(" ".join(data.split()))

    def all(self, *tags):
        return [(tag, attributes) for tag, attributes in self.elements if tag in tags]

    @property
    def text(self):
        return "\n".join(self.words)


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


@pytest.fixture(scope="module")
def fit(small_fit):
    return small_fit


@pytest.fixture(scope="module")
def plain(fit):
    """Without anything that is optional."""
    return ReportedOrgan("bladder", fit, "good", seeds=[tuple(CENTER)], seconds=0.25)


@pytest.fixture(scope="module")
def full(fit):
    """With confidence, choices, warnings and a reference."""
    choice = Choice(
        "net", "17x11", (Diagnostic("finer_net_lowered_cost", {"net": "17x11", "change": 0.26, "explained": 9e-3}),)
    )
    told = {"choices": (choice,), "confidence": Confidence(), "problems": fit.problems, "iterations": fit.iterations}
    fields = {field.name: getattr(fit, field.name) for field in dataclasses.fields(fit)}
    reference = ReadReference(ellipsoid(), "surface")
    return ReportedOrgan(
        NASTY,
        SimpleNamespace(**{**fields, **told}),
        "check",
        seeds=[tuple(CENTER)],
        seconds=0.25,
        asked=("threshold",),
        warnings=WARNINGS,
        compared=compared_organ(NASTY, fit.surface, reference, Path("truth <1>.json"), points=500),
    )


def page_of(organs, image, *, dpi=30, **more):
    """Page whose pictures have few pixels, for tests that do not look at them."""
    more = {"program": "vic-registration 9", "date": DATE, **more}
    with matplotlib.rc_context({"savefig.dpi": dpi}):
        return report_html(organs, image, Source(f"/data/{NASTY}/\udcff.nii", "series <2>"), **more)


@pytest.fixture(scope="module")
def page(full, plain, image):
    gaps, files = ["bladder and <b> are 3 mm apart"], [(f"bladder.vtp, {NASTY}.vtp", "triangles")]
    return page_of([full, plain], image, dpi="figure", gaps=gaps, files=files)


@pytest.fixture(scope="module")
def parsed(page):
    return Page(page)


def test_the_page_is_well_formed_html_5(page, parsed):
    assert page.startswith('<!DOCTYPE html>\n<html lang="en">')
    assert [tag for tag, _ in parsed.elements[:3]] == ["html", "head", "meta"]
    assert parsed.elements[2][1] == {"charset": "utf-8"}
    ids = [attributes["id"] for _, attributes in parsed.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    # Also where a path holds bytes that are no text.
    page.encode("utf-8")


def test_nothing_is_asked_of_another_file_or_machine(page, parsed):
    assert {tag for tag, _ in parsed.elements}.isdisjoint({"script", "link", "iframe", "object", "form"})
    sources = [attributes["src"] for _, attributes in parsed.elements if "src" in attributes]
    assert sources
    assert all(source.startswith("data:image/jpeg;base64,") for source in sources)
    links = [attributes["href"] for _, attributes in parsed.elements if "href" in attributes]
    assert links == ["#organ-1", "#organ-2"]
    assert not re.search(r"https?:|url\(|@import", page)
    assert any("default-src 'none'" in attributes.get("content", "") for _, attributes in parsed.all("meta"))


def test_what_users_wrote_is_text_and_no_html(page, parsed):
    assert NASTY in parsed.text
    assert f"/data/{NASTY}/\ufffd.nii" in parsed.text
    assert {"series <2>", "truth <1>.json", "bladder and <b> are 3 mm apart"} <= set(parsed.words)
    assert parsed.all("b") == []
    assert any(NASTY in attributes["alt"] for _, attributes in parsed.all("img"))


def test_headings_are_in_order_and_every_picture_has_words(parsed):
    levels = [int(tag[1]) for tag, _ in parsed.all("h1", "h2", "h3")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(later <= earlier + 1 for earlier, later in zip(levels, levels[1:]))
    assert all(len(attributes["alt"]) > 30 for _, attributes in parsed.all("img"))
    assert all(attributes.get("scope") in ("row", "col") for _, attributes in parsed.all("th"))


def test_pictures_are_jpeg_files_that_keep_their_proportions(page, parsed):
    for _, attributes in parsed.all("img"):
        content = base64.b64decode(attributes["src"].partition(",")[2], validate=True)
        assert content.startswith(b"\xff\xd8")
        assert content.endswith(b"\xff\xd9")
        assert attributes.keys() == {"src", "alt"}
    assert "height: auto" in page


def test_every_organ_has_its_section_and_a_line_in_the_overview(parsed):
    sections = [attributes for tag, attributes in parsed.all("section") if attributes.get("class") == "organ"]
    assert [attributes["aria-labelledby"] for attributes in sections] == ["organ-1", "organ-2"]
    assert "All organs" in parsed.words
    assert "2, see below" in parsed.words


def test_the_verdict_is_the_first_line_of_a_section_and_in_the_overview(plain, image, parsed):
    for verdict in ("good", "check", "poor"):
        words = Page(page_of([dataclasses.replace(plain, verdict=verdict, warnings=WARNINGS)], image)).words
        last = len(words) - 1 - words[::-1].index("bladder")
        assert words[last + 1] == verdict
        assert words[last + 2].startswith(": ")
        assert "Look at these" in words[last + 3]
    assert parsed.words[parsed.words.index("organ") + 1] == "verdict"
    told = [attributes["class"] for _, attributes in parsed.all("p") if "verdict" in attributes.get("class", "")]
    assert told == ["verdict check", "verdict good"]


def test_warnings_are_told_word_by_word_before_the_result(parsed):
    places = [parsed.words.index(warning) for warning in WARNINGS]
    assert places == sorted(places)
    assert places[-1] < parsed.words.index("Result")
    assert "Look at these 2 warnings first" in parsed.words


def test_confidence_choices_and_deviation_are_told(parsed, full):
    # Of two organs one has a reference.
    for words, count in (("Confidence", 2), ("What was chosen and why", 2), ("Deviation from the reference", 1)):
        assert parsed.words.count(words) == count
    volume = f"{full.fit.surface.volume() / 1000.0:.1f} ± 0.4 ml"
    assert volume in parsed.words
    assert f"{volume} (one standard deviation, calibrated on phantoms)" in parsed.words
    assert "on 3.0 % of the area" in parsed.words
    start = parsed.words.index("standard deviation")
    assert parsed.words[start + 1 : start + 5] == ["0.20 mm", "0.30 mm", "0.50 mm", "0.50 mm"]
    assert "With the net 17x11 the cost fell by 26.0%, of which noise explains 0.9%." in parsed.words
    found = full.compared.comparison
    assert f"{found.to_surface.mean:.2f}" in parsed.words
    assert f"{found.to_reference.mean_signed:+.2f}" in parsed.words
    volumes = (found.reference_ml, found.volume_ml)
    row = [f"{found.volume_dice:.3f}", f"{found.hausdorff:.2f} mm", *(f"{volume:.1f} ml" for volume in volumes)]
    start = parsed.words.index(row[0])
    assert parsed.words[start : start + 5] == [*row, f"{found.volume_difference_ml:+.1f} ml"]
    assert parsed.words[parsed.words.index("Hausdorff") :][:4] == ["Hausdorff", "reference", "fitted", "difference"]


def test_a_volume_has_no_standard_deviation_where_much_of_the_surface_follows_no_edge(plain, image):
    assert volume_text(131.96, SimpleNamespace(volume_calibrated=True, volume_sd_ml=0.632)) == "132.0 ± 0.6 ml"
    assert volume_text(1.234, SimpleNamespace(volume_calibrated=True, volume_sd_ml=0.043)) == "1.23 ± 0.04 ml"
    assert volume_text(131.96, SimpleNamespace(volume_calibrated=False, volume_sd_ml=3.2)) == "132.0 ml"
    unsure = Confidence()
    unsure.volume_calibrated = False
    fit = SimpleNamespace(**{**vars(plain.fit), "problems": (), "iterations": 3, "confidence": unsure})
    text = Page(page_of([dataclasses.replace(plain, fit=fit)], image)).text
    assert "±" not in text
    assert "without a standard deviation, because much of the surface follows no edge" in text


def test_the_convergence_comes_last_and_rising_costs_are_explained(parsed):
    headings = [word for word in parsed.words if word in ("Result", "Inputs", "Convergence", "What was chosen and why")]
    assert headings == ["Result", "Inputs", "What was chosen and why", "Convergence"] * 2
    assert parsed.text.count("the cost may rise from one stage to the next") == 2
    last = [attributes["alt"] for _, attributes in parsed.all("img")][-1]
    assert last.startswith("Cost against iteration")


def test_inputs_tell_what_was_given_and_what_was_chosen(parsed):
    assert "R -12.0, A 8.0, S -20.0" in parsed.words
    assert parsed.words[parsed.words.index("Grey levels of the organ") + 2] == "as given"
    assert parsed.words[parsed.words.index("Erosion") + 2] == "automatic"


def test_sections_without_content_are_absent(plain, image):
    words = Page(page_of([plain], image)).words
    for absent in ("All organs", "Between the organs"):
        assert absent not in words
    assert not [word for word in words if "Look at" in word or "Deviation" in word or "Files" in word]
    assert {"Result", "Slices and surface", "Convergence", "Inputs"} <= set(words)


def test_the_page_stays_small(page):
    # Two organs of a small phantom; three of the demo's MRI with a reference take 2 MB.
    assert len(page) < 1.5e6


def test_the_same_fit_gives_the_same_page(full, image):
    page = page_of([full], image)
    assert page == page_of([full], image)
    assert "2026-03-01 12:30:00+01:00" in page


def test_a_fit_that_did_not_end_well_is_told(plain, image):
    problem = SimpleNamespace(diagnostic=Diagnostic("folded_over", dict.fromkeys("rasuv", 0.5)), kind="fold")
    bad = SimpleNamespace(**{**vars(plain.fit), "problems": (problem,), "converged": False, "iterations": 3})
    bad.confidence = plain.fit.confidence
    bad.region = None
    words = Page(page_of([dataclasses.replace(plain, fit=bad)], image)).words
    assert f"no: {problem.diagnostic.sentence()}" in words
    assert "no, after 3 iterations" in words


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (np.diag([1.0, 1.0, 4.0]), "axial slices; i runs to right, j to anterior, k to superior"),
        (np.diag([-1.0, -4.0, 1.0]), "coronal slices; i runs to left, j to posterior, k to superior"),
        (np.diag([1.0, 1.0, 1.0]), "axial slices; i runs to right, j to anterior, k to superior"),
    ],
)
def test_the_orientation_is_told_in_words(columns, expected):
    matrix = np.eye(4)
    matrix[:3, :3] = columns
    assert orientation_text(Image(np.zeros((3, 3, 3)), matrix)) == expected


def test_a_turned_volume_is_told_by_its_angle():
    angle, matrix = np.radians(10.0), np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    assert orientation_text(Image(np.zeros((3, 3, 3)), matrix)).endswith(
        "turned by up to 10.0° from the patient's axes"
    )


# ------------------------------------------------------------------ the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a fit of two organs in one image beside a reference."""
    place = tmp_path_factory.mktemp("report & <more>")
    write_image(ellipsoid_image(), place / "mri.nii.gz")
    write_surface(ellipsoid(), place / "truth.json", name="truth", net="9x7", closure="smooth")
    seed = [float(number) for number in SEED.split(",")]
    organs = [{"organ": "bladder", "seed": [seed]}, {"organ": "R&D's", "seed": [seed], "erosion": 1}]
    config = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    (place / "organs.json").write_text(json.dumps(config), encoding="utf-8")
    words = ["--config", place / "organs.json", "--reference", place / "truth.json", "--output", place / "out"]
    # Nobody looks at these surfaces and pictures.
    with pytest.MonkeyPatch.context() as patch, matplotlib.rc_context({"savefig.dpi": 30}):
        without_finer_nets(patch)
        without_shapes(patch)
        compare_few_points(patch)
        assert cli.main(["fit", str(place / "mri.nii.gz"), *map(str, words), "--step", "--quiet"]) == 0
    return place


@pytest.fixture(scope="module")
def written(folder):
    return (folder / "out" / "report.html").read_text(encoding="utf-8")


def test_the_command_writes_a_page_of_all_organs_and_their_deviation(written, folder):
    words = Page(written).words
    assert str(folder / "mri.nii.gz") in words
    assert words.count("Deviation from the reference") == 2
    assert words.count("truth.json") == 2
    # Both are one organ, so that their surfaces overlap.
    assert any(word.startswith("bladder and R&D's") for word in words)
    assert "bladder.vtp, R&D's.vtp" in words
    assert "organs.step" in words


def test_all_files_that_the_page_names_are_there(written, folder):
    files = {path.name for path in (folder / "out").iterdir()}
    named = Page(written).words
    last = named[named.index("Files beside this report") :]
    told = {name for word in last for name in word.split(", ") if name in files}
    assert told == files - {"report.html"}
    assert "overview.png" in told


def test_options_that_were_given_are_told_apart(written):
    words = Page(written).words
    origins = [words[number + 2] for number, word in enumerate(words) if word == "Erosion"]
    assert origins == ["automatic", "as given"]


@pytest.mark.long
def test_without_pictures_there_is_no_page_and_no_old_one(folder, tmp_path):
    words = ["fit", str(folder / "mri.nii.gz"), "--organ", "bladder", "--seed", SEED, "--quiet"]
    assert cli.main([*words, "--output", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").is_file()
    assert cli.main([*words, "--output", str(tmp_path), "--no-pictures"]) == 0
    assert not (tmp_path / "report.html").exists()
    assert (tmp_path / "report.json").is_file()


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        (["--reference", "truth.json", "--no-pictures"], "--no-pictures"),
        (["--label", "3"], "--reference"),
        (["--reference", "truth.json", "--label", "3"], "label"),
        (["--reference", "missing.stl"], "missing.stl"),
    ],
)
def test_a_reference_that_cannot_be_used_ends_with_one_line(folder, tmp_path, capsys, more, wanted):
    more = [str(folder / word) if word.endswith((".json", ".stl")) else word for word in more]
    words = ["fit", str(folder / "mri.nii.gz"), "--organ", "bladder", "--seed", SEED, "--output", str(tmp_path / "out")]
    assert cli.main([*words, *more]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert wanted in lines[0]
    assert not (tmp_path / "out").exists()
