"""The report: one page that needs nothing else, and tells all that there is to tell and nothing that there is not."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
from datetime import datetime, timedelta, timezone
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from small_phantom import CENTER, SEED, ellipsoid, ellipsoid_image

from VICRegistrationLib import cli
from VICRegistrationLib.analysis.comparison import compare, distances_from
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.automatic import Choice
from VICRegistrationLib.registration.organ import finish, fit_organ
from VICRegistrationLib.report.canvas import blank_figure, drawn_pixels, indexed_png, png_bytes, read_pixels
from VICRegistrationLib.report.confidence_picture import area_percentiles
from VICRegistrationLib.report.contents import Compared, ReportedOrgan, Source
from VICRegistrationLib.report.figures import confidence_percentiles, organ_figures
from VICRegistrationLib.report.html import Html, element, table, text
from VICRegistrationLib.report.page import orientation_text, report_html
from VICRegistrationLib.report.panels import fine_mesh

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
    unsupported_share = 0.12

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
        if self.open and self.open[-1] != "style":
            self.words.append(data)

    def all(self, *tags):
        return [(tag, attributes) for tag, attributes in self.elements if tag in tags]

    @property
    def text(self):
        return "\n".join(self.words)


@pytest.fixture(scope="module")
def image():
    return ellipsoid_image()


@pytest.fixture(scope="module")
def fit(image):
    return finish(fit_organ(image, CENTER[None]))


@pytest.fixture(scope="module")
def plain(image, fit):
    """Without anything that is optional."""
    return ReportedOrgan("bladder", fit, organ_figures(image, fit, "bladder"), [tuple(CENTER)], (), 0.25)


@pytest.fixture(scope="module")
def full(image, fit):
    """With confidence, choices, warnings and a reference."""
    choice = Choice(
        "net", "17x11", (Diagnostic("finer_net_lowered_cost", {"net": "17x11", "change": 0.26, "explained": 9e-3}),)
    )
    told = {"choices": (choice,), "confidence": Confidence(), "problems": fit.problems, "iterations": fit.iterations}
    fields = {field.name: getattr(fit, field.name) for field in dataclasses.fields(fit)}
    extended = SimpleNamespace(**{**fields, **told})
    mesh, truth = fine_mesh(fit.surface), ellipsoid()
    compared = Compared(
        "truth <1>.json", compare(fit.surface, truth, n_points=500), mesh, distances_from(truth, mesh.points)
    )
    return ReportedOrgan(
        NASTY,
        extended,
        organ_figures(image, extended, NASTY, reference=truth, compared=compared),
        [tuple(CENTER)],
        ("threshold",),
        0.25,
        warnings=WARNINGS,
        percentiles=confidence_percentiles(extended),
        compared=compared,
    )


def page_of(organs, image, **more):
    more = {"program": "vic-registration 9", "date": DATE, **more}
    return report_html(organs, image, Source(f"/data/{NASTY}/\udcff.nii", "series <2>"), **more)


@pytest.fixture(scope="module")
def page(full, plain, image):
    gaps, files = ["bladder and <b> are 3 mm apart"], [(["bladder.vtp", f"{NASTY}.vtp"], "triangles")]
    return page_of([full, plain], image, overview=full.figures.slices, gaps=gaps, files=files)


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
    assert all(source.startswith("data:image/png;base64,") for source in sources)
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


def test_pictures_keep_their_proportions(parsed):
    from PIL import Image as Picture

    for _, attributes in parsed.all("img"):
        content = base64.b64decode(attributes["src"].partition(",")[2], validate=True)
        size = Picture.open(io.BytesIO(content)).size
        assert size == (int(attributes["width"]), int(attributes["height"]))


def test_every_organ_has_its_section_and_a_line_in_the_overview(parsed):
    sections = [attributes for tag, attributes in parsed.all("section") if attributes.get("class") == "organ"]
    assert [attributes["aria-labelledby"] for attributes in sections] == ["organ-1", "organ-2"]
    assert "All organs" in parsed.words
    assert "2, see there" in parsed.words


def test_warnings_are_told_word_by_word_before_the_result(parsed):
    places = [parsed.words.index(warning) for warning in WARNINGS]
    assert places == sorted(places)
    assert places[-1] < parsed.words.index("Result")
    assert "Look at these 2 points first" in parsed.words


def test_confidence_choices_and_deviation_are_told(parsed, full):
    # Of two organs one has a reference.
    for words, count in (("Confidence", 2), ("What was chosen and why", 2), ("Deviation from the reference", 1)):
        assert parsed.words.count(words) == count
    assert f"{full.fit.surface.volume() / 1000.0:.1f} ± 0.4 ml" in parsed.words
    assert "on 12 % of the area" in parsed.words
    assert "With the net 17x11 the cost fell by 26.0%, of which noise explains 0.9%." in parsed.words
    found = full.compared.comparison
    assert f"{found.to_surface.mean:.2f}" in parsed.words
    assert f"{found.to_reference.mean_signed:+.2f}" in parsed.words
    volumes = (found.reference_ml, found.volume_ml)
    row = [f"{found.volume_dice:.3f}", f"{found.hausdorff:.2f} mm", *(f"{volume:.1f} ml" for volume in volumes)]
    start = parsed.words.index(row[0])
    assert parsed.words[start : start + 5] == [*row, f"{found.volume_difference_ml:+.1f} ml"]
    assert parsed.words[parsed.words.index("Hausdorff") :][:4] == ["Hausdorff", "reference", "fitted", "difference"]


def test_inputs_tell_what_was_given_and_what_was_chosen(parsed):
    assert "R -12.0, A 8.0, S -20.0" in parsed.words
    assert parsed.words[parsed.words.index("Grey levels of the organ") + 2] == "as given"
    assert parsed.words[parsed.words.index("Erosion") + 2] == "automatic"


def test_sections_without_content_are_absent(plain, image):
    words = Page(page_of([plain], image)).words
    for absent in ("All organs", "Between the organs"):
        assert absent not in words
    assert not [word for word in words if "Look at" in word or "Deviation" in word or "Files" in word]
    assert {"Result", "Slices in three planes", "The surface", "Convergence", "Inputs"} <= set(words)


def test_the_page_stays_small(page):
    # Two organs of a small phantom; three of the demo's MRI with a reference take 2 MB.
    assert len(page) < 1.5e6


def test_the_same_fit_gives_the_same_page(full, image):
    assert page_of([full], image) == page_of([full], image)
    assert "2026-03-01 12:30:00+01:00" in page_of([full], image)


def test_a_fit_that_did_not_end_well_is_told(plain, image):
    problem = SimpleNamespace(diagnostic=Diagnostic("folded_over", dict.fromkeys("rasuv", 0.5)), kind="fold")
    bad = SimpleNamespace(**{**vars(plain.fit), "problems": (problem,), "converged": False, "iterations": 3})
    bad.confidence = plain.fit.confidence
    bad.region = None
    words = Page(page_of([dataclasses.replace(plain, fit=bad)], image)).words
    assert f"no: {problem.diagnostic.sentence()}" in words
    assert "no, after 3 iterations" in words


def test_text_is_escaped_once():
    assert text(element("p", "a < b", title='"')) == '<p title="&quot;">a &lt; b</p>'
    assert element("td", Html("<i>x</i>"), "&") == "<td><i>x</i>&amp;</td>"
    assert text("a\x00b\ud800c") == "a\ufffdb\ufffdc"
    assert "<thead>" not in table((), [("name", 1)])


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


def test_percentiles_are_those_of_the_area():
    mesh = fine_mesh(ellipsoid())
    # Heights along an axis of a sphere are spread evenly over its area; this ellipsoid is near enough to 10 %.
    heights = mesh.points[:, 2] - CENTER[2]
    low, middle, high = area_percentiles(mesh, heights, (0.0, 50.0, 100.0))
    assert middle == pytest.approx(0.0, abs=0.5)
    assert (low, high) == (pytest.approx(-22.0, abs=0.5), pytest.approx(22.0, abs=0.5))


def test_a_smaller_picture_keeps_white_greys_and_the_colour_of_a_thin_line(tmp_path):
    from PIL import Image as Picture

    figure = blank_figure((3.0, 3.0))
    axes = figure.add_axes((0.2, 0.2, 0.6, 0.6))
    axes.imshow(np.random.default_rng(0).normal(size=(300, 300)), cmap="gray")
    axes.plot([0, 299], [0, 299], color="#00c8ff", linewidth=2.0)
    axes.set_axis_off()
    whole = png_bytes(figure)
    (tmp_path / "whole.png").write_bytes(whole)
    assert np.array_equal(read_pixels(tmp_path / "whole.png"), drawn_pixels(figure))
    smaller = indexed_png(drawn_pixels(figure))
    assert len(smaller) < 0.7 * len(whole)
    before, after = (np.asarray(Picture.open(io.BytesIO(each)).convert("RGB")).astype(int) for each in (whole, smaller))
    assert tuple(after[0, 0]) == (255, 255, 255)
    assert np.abs(before - after).max() < 16


def test_a_smaller_picture_keeps_rare_colours():
    from PIL import Image as Picture

    shade, hue = np.meshgrid(np.linspace(0.3, 1.0, 300), np.linspace(0.0, 1.0, 300))
    pixels = (255.0 * shade[..., None] * np.stack([hue, 0.7 + 0.0 * hue, 1.0 - hue], axis=-1)).astype(np.uint8)
    pixels[:3, :3] = (180, 0, 40)
    after = np.asarray(Picture.open(io.BytesIO(indexed_png(pixels))).convert("RGB")).astype(int)
    assert np.abs(after - pixels)[:3, :3].max() < 16


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
    with pytest.MonkeyPatch.context() as patch:
        # Nobody looks at these pictures.
        patch.setattr("VICRegistrationLib.report.canvas._DPI", 30)
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
