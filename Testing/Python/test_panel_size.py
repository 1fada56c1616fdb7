"""The panel's size in plain Qt: its .ui file with look-alikes of Slicer's widgets, off screen."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
pytest.importorskip(
    "PySide6.QtWidgets", reason="PySide6 is not installed, or lacks a system library", exc_type=ImportError
)

import draw_panel
from PySide6.QtCore import QPoint
from PySide6.QtGui import QFontDatabase
from PySide6.QtWidgets import QApplication, QWidget

UI = Path(__file__).resolve().parents[2] / "VICRegistration" / "Resources" / "UI" / "VICRegistration.ui"
WIDEST = 500
TALLEST = 600
LONG = (
    "the region may have leaked through a bridge that is wider than the erosion; look at the slices, and erode more "
    * 3
)
STACKS = [
    ("AX T2 tse", True, "2.7 mm, 1.8°"),
    ("COR T2 with a name that nobody would type " * 3, True, "12.7 mm, 11.8°"),
    *[("DWI", False, "left out")] * 6,
]
PATH = "Written: /home/" + "somebody_with_a_long_name" * 8 + "/organs.step"


@pytest.fixture(scope="module")
def application():
    QApplication.setStyle("Fusion")
    made = QApplication.instance() or QApplication([])
    if not QFontDatabase.families():
        pytest.skip("there is no font to measure texts with")
    return made


def panel(path=UI, *, expanded=False, **contents):
    """The panel, filled; with all its sections open on demand."""
    made = draw_panel.read_panel(path)
    if expanded:
        for section in made.findChildren(draw_panel.Section):
            section.setProperty("collapsed", False)
    draw_panel.fill(made, **contents)
    return made


def asked_widths(made, application, *, passes=6):
    """Widths that the panel asks for while its window is wide: Slicer never makes it narrower than that again."""
    made.resize(WIDEST + 200, 1000)
    made.show()
    widths = []
    for _ in range(passes):
        application.processEvents()
        widths.append(made.minimumSizeHint().width())
        made.resize(max(made.width(), widths[-1]), made.height())
    return widths


CONTENTS = {
    "opening": {"organs": [], "points": []},
    "three organs": {},
    "further stacks": {"stacks": STACKS},
    "long names": {
        "organs": [("a bladder with a name that nobody would type " * 3, "#de9942", "131.8", "fitted, not settled")]
        * 8,
        "points": [("-121.7, -138.2, -114.0", "+14.90")] * 8,
    },
    "long messages": dict.fromkeys(
        (
            *("regionStatusLabel", "fitStatusLabel", "correctStatusLabel", "compareStatusLabel"),
            *("modelStatusLabel", "landmarksPlacedLabel"),
        ),
        LONG,
    )
    | {"exportStatusLabel": PATH},
}


@pytest.mark.parametrize("expanded", [False, True], ids=["as opened", "all sections open"])
@pytest.mark.parametrize("name", CONTENTS)
def test_the_panel_stays_narrow(application, name, expanded):
    assert max(asked_widths(panel(expanded=expanded, **CONTENTS[name]), application)) <= WIDEST


@pytest.mark.parametrize(("scale", "opened", "everything"), [(1.0, 340, 440), (1.3, 400, WIDEST)])
def test_nothing_is_wider_than_its_words(application, scale, opened, everything):
    # Slicer never makes the panel narrower than it asks for; with large fonts it is to stay beside the views too.
    usual = application.font()
    large = application.font()
    large.setPointSizeF(scale * usual.pointSizeF())
    application.setFont(large)
    try:
        assert max(asked_widths(panel(stacks=STACKS), application)) <= opened
        assert max(asked_widths(panel(stacks=STACKS, expanded=True), application)) <= everything
    finally:
        application.setFont(usual)


def test_no_section_is_wide_by_itself(application):
    widths = draw_panel.section_widths()
    assert len(widths) == 9
    assert {title: width for title, width in widths.items() if width > WIDEST - 60} == {}


def test_a_table_that_adjusts_to_its_contents_would_be_noticed(application, tmp_path):
    # As the file was once: the panel asked for its own width and a scroll bar, until the views were off the screen.
    text = UI.read_text(encoding="utf-8")
    policy = '<property name="sizeAdjustPolicy"><enum>QAbstractScrollArea::AdjustToContents</enum></property>'
    growing = re.sub(r'(<widget class="QTableWidget" name="organsTable">)', rf"\1{policy}", text)
    assert growing != text
    path = tmp_path / "growing.ui"
    path.write_text(growing, encoding="utf-8")
    assert max(asked_widths(panel(path), application)) > WIDEST


@pytest.mark.parametrize(("organs", "stacks"), [(1, 0), (3, 2), (1, 8), (6, 0), (6, 8)])
def test_what_one_works_with_stands_in_600_pixels(application, organs, stacks):
    rows = [(f"organ {number}", "#de9942", "131.8", "fitted") for number in range(organs)]
    made = panel(
        organs=rows, stacks=STACKS[:stacks], fitStatusLabel=f"bladder: 31 iterations\nChosen: net 17x11\n{LONG[:58]}"
    )
    made.resize(420, 1000)
    made.show()
    application.processEvents()
    first, last = (made.findChild(QWidget, name) for name in ("volumeSelector", "fitStatusLabel"))
    top = first.mapTo(made, QPoint(0, 0)).y()
    bottom = last.mapTo(made, QPoint(0, last.height())).y()
    assert 300 < bottom - top <= TALLEST


def test_a_table_is_as_high_as_its_rows():
    from VICRegistrationLib.gui.widgets import tableHeight

    heights = [tableHeight(rows, row=24, header=20, frame=1) for rows in (0, 2, 3, 6, 40)]
    assert heights == [70, 70, 94, 166, 166]
