"""Draw the module's panel for the pages: its .ui file in plain Qt widgets that look much like Slicer's.

A drawing, not a screenshot: Slicer's own widgets exist in Slicer only. Needs PySide6, and no screen.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QBuffer, QPointF, QSize, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPen, QPixmap, QPolygonF
from PySide6.QtUiTools import QUiLoader
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QHBoxLayout,
    QHeaderView,
    QLineEdit,
    QSlider,
    QStyle,
    QStyleOptionButton,
    QStylePainter,
    QTableWidgetItem,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from VICRegistrationLib.gui.option_texts import WIDGETS, optionTexts
from VICRegistrationLib.gui.widgets import LEAST_ROWS, MOST_ROWS, STACK_ROWS, organRows, tableHeight
from VICRegistrationLib.registration.options import OPTIONS, FitOptions

ROOT = Path(__file__).resolve().parent.parent
PANEL = ROOT / "VICRegistration" / "Resources" / "UI" / "VICRegistration.ui"
PICTURE = ROOT / "Resources" / "Screenshots" / "panel.png"
WIDTH = 420
SPACER = 40  # Height of the .ui file's empty place at the bottom.
ORGANS = [
    ("bladder", "#f5b82e", "131.9", "fitted"),
    ("vagina", "#ea6a9d", "17.4", "fitted"),
    ("rectum", "#4fb477", "42.2", "fitted"),
]
# Further stacks: name, whether it is ticked, and what became of it.
STACKS = [("Phantom, axial", True, "2.7 mm, 2.6°")]
BOUNDARY_HEADINGS = ["Point (R, A, S; mm)", "Off (mm)"]
BOUNDARY_POINTS = [("2.4, 61.0, 18.3", "+4.90"), ("-21.7, 38.2, 14.0", "-0.12")]
MODEL_ORGANS = [("bladder", "bladder"), ("vagina", "vagina"), ("rectum", "predict")]
CHOICES = {
    "presetCombo": ["uterus"],
    "sourceCombo": ["Seeds and grey levels"],
    **{
        widget: [OPTIONS[option].choices[getattr(FitOptions, option)]]
        for option, _, widget in WIDGETS
        if OPTIONS[option].choices
    },
    "referenceKindCombo": ["Segment of a segmentation"],
    "colorByCombo": ["Deviation from the reference"],
    "genericModelCombo": ["Pelvis"],
    "modelMeshCombo": ["No mesh"],
}
TEXTS = {
    "regionStatusLabel": "Region: 131.2 ml",
    "fitStatusLabel": "bladder: 131.9 ± 0.6 ml; 18 iterations, cost 0.022, 0.72 s\n"
    "Chosen: net 17x11, edge 1.77 mm, smoothness 0.00019",
    "correctStatusLabel": "The surface is up to 4.9 mm from the points.",
    "landmarksPlacedLabel": "1 of 6 placed; next: coccyx, tip",
    "modelStatusLabel": "Model fitted to bladder, vagina in 0.8 s",
    "compareStatusLabel": "Against expert: bladder:\n"
    "mean 0.82 mm (signed +0.10), 95 % 2.40 mm, Hausdorff 5.97 mm, Dice 0.951\nvolume 132.0 ml, reference 130.4 ml",
}


# Rows that do not apply to an organ from seeds that is compared with a segment and written as STEP.
HIDDEN = (
    *("segmentLabel", "segmentSelector", "plotFrame", "referenceModelLabel", "referenceModelSelector"),
    *("meshSizeLabel", "meshSizeSlider", "meshOrderLabel", "meshOrderCombo", "meshWallLabel", "meshWallSlider"),
    *("cancelExportButton", "givenLevelsLabel", "insideSpin", "outsideSpin", "modelFileLabel", "modelFileEdit"),
    *("modelMeshSizeLabel", "modelMeshSizeSlider"),
)


class Section(QWidget):
    """Look-alike of ctkCollapsibleButton: a button across the panel over a frame."""

    HEADER = 26

    def __init__(self, parent):
        super().__init__(parent)
        self.setContentsMargins(0, self.HEADER, 0, 0)

    def sizeHint(self):
        """Ask for the contents' own size hint below the button."""
        width = self.fontMetrics().horizontalAdvance(self.property("text") or "") + 40
        if self.property("collapsed") or self.layout() is None:
            return QSize(width, self.HEADER)
        return super().sizeHint().expandedTo(QSize(width, self.HEADER))

    def minimumSizeHint(self):
        """Ask for the size hint as the minimum, as a button does and ctkCollapsibleButton with it."""
        return self.sizeHint()

    def paintEvent(self, _event):
        """Draw the button and the frame."""
        painter, option = QStylePainter(self), QStyleOptionButton()
        painter.setPen(self.palette().mid().color())
        painter.drawRect(self.rect().adjusted(0, self.HEADER // 2, -1, -1))
        option.initFrom(self)
        option.rect = self.rect()
        option.rect.setHeight(self.HEADER)
        painter.drawControl(QStyle.CE_PushButtonBevel, option)
        text = option.rect.adjusted(28, 0, 0, 0)
        painter.setPen(self.palette().buttonText().color())
        painter.drawText(text, Qt.AlignVCenter | Qt.AlignLeft, self.property("text"))
        option.rect.setRect(8, 7, 12, 12)
        arrow = QStyle.PE_IndicatorArrowRight if self.property("collapsed") else QStyle.PE_IndicatorArrowDown
        painter.drawPrimitive(arrow, option)

    def finish(self):
        """Hide what a collapsed section hides."""
        if self.property("collapsed"):
            for child in self.findChildren(QWidget, options=Qt.FindDirectChildrenOnly):
                child.hide()


class Slider(QWidget):
    """Look-alike of ctkSliderWidget: a slider and a number."""

    def finish(self):
        """Take over the properties of the .ui file, which are known only when it is read."""
        low, high, value = (self.property(name) or 0.0 for name in ("minimum", "maximum", "value"))
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(slider(low, high, value))
        row.addWidget(number(self, low, high, value))


class Range(QWidget):
    """Look-alike of ctkRangeWidget: a slider with two handles between two numbers."""

    def finish(self):
        """Show grey levels as they are in the demo's MRI."""
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(number(self, 0, 2000, 610))
        row.addWidget(TwoHandles(), stretch=1)
        row.addWidget(number(self, 0, 2000, 1480))


class TwoHandles(QWidget):
    """Look-alike of ctkRangeSlider, at 30 and 75 % of its range."""

    def paintEvent(self, _event):
        """Draw groove and handles."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        middle = self.height() / 2
        for start, end, color in ((0, 1, self.palette().mid()), (0.3, 0.75, self.palette().highlight())):
            painter.setPen(QPen(color.color(), 4))
            painter.drawLine(QPointF(start * self.width(), middle), QPointF(end * self.width(), middle))
        painter.setPen(self.palette().dark().color())
        painter.setBrush(self.palette().button())
        for place in (0.3, 0.75):
            painter.drawRoundedRect(place * self.width() - 6, middle - 7, 12, 14, 3, 3)


class NodeBox(QComboBox):
    """Look-alike of qMRMLNodeComboBox."""

    def finish(self):
        """Show the demo's MRI, and that no model is chosen."""
        self.addItem("Pelvis phantom" if self.objectName() == "volumeSelector" else "None")


class SegmentBoxes(QWidget):
    """Look-alike of qMRMLSegmentSelectorWidget: segmentation and segment."""

    def finish(self):
        """Show that nothing is chosen."""
        row = (QHBoxLayout if self.property("horizontalLayout") else QVBoxLayout)(self)
        row.setContentsMargins(0, 0, 0, 0)
        for text in ("Segmentation", "Segment"):
            box = QComboBox()
            box.addItem(text)
            row.addWidget(box)


class PlaceButtons(QWidget):
    """Look-alike of qSlicerMarkupsPlaceWidget with its two buttons for placing and for removing points."""

    def finish(self):
        """Draw the buttons."""
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        for icon in (place_icon(), self.style().standardIcon(QStyle.SP_TrashIcon)):
            button = QToolButton()
            button.setIcon(icon)
            row.addWidget(button)
        row.addStretch(1)


LOOKALIKES = {
    "qMRMLWidget": QWidget,
    "qMRMLNodeComboBox": NodeBox,
    "qMRMLSegmentSelectorWidget": SegmentBoxes,
    "qSlicerMarkupsPlaceWidget": PlaceButtons,
    "ctkCollapsibleButton": Section,
    "ctkSliderWidget": Slider,
    "ctkPathLineEdit": QLineEdit,
    "ctkRangeWidget": Range,
}


class Loader(QUiLoader):
    """Reads a .ui file with look-alikes in place of Slicer's widgets."""

    def createWidget(self, class_name, parent=None, name=""):
        """Make one widget, as Qt asks for it."""
        made = LOOKALIKES[class_name](parent) if class_name in LOOKALIKES else super().createWidget(class_name, parent)
        made.setObjectName(name)
        return made


def slider(low: float, high: float, value: float) -> QSlider:
    """Make a slider."""
    made = QSlider(Qt.Horizontal)
    made.setRange(0, 1000)
    made.setValue(round(1000 * (value - low) / (high - low)))
    return made


def number(owner: QWidget, low: float, high: float, value: float) -> QDoubleSpinBox:
    """Make a number field with the owner's decimals and unit."""
    made = QDoubleSpinBox()
    made.setDecimals(owner.property("decimals") or 0)
    made.setRange(low, high)
    made.setPrefix(owner.property("prefix") or "")
    made.setSuffix(owner.property("suffix") or "")
    made.setValue(value)
    return made


def drawn_icon(paint) -> QIcon:
    """Make an icon of 16 x 16 pixels with a function that is handed the painter."""
    pixmap = QPixmap(16, 16)
    pixmap.fill(Qt.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.Antialiasing)
    paint(painter)
    painter.end()
    return QIcon(pixmap)


def place_icon() -> QIcon:
    """Draw the mouse pointer with a red point."""

    def paint(painter):
        painter.setBrush(QColor("#d03030"))
        painter.drawEllipse(QPointF(4, 4), 3, 3)
        painter.setBrush(QColor("white"))
        painter.drawPolygon(QPolygonF([QPointF(5, 5), QPointF(14, 9), QPointF(10, 10), QPointF(9, 14)]))

    return drawn_icon(paint)


def eye_icon() -> QIcon:
    """Draw the eye that means visible."""

    def paint(painter):
        painter.setPen(QPen(QColor("#303030"), 1.2))
        painter.drawEllipse(QPointF(8, 8), 7, 4)
        painter.setBrush(QColor("#303030"))
        painter.drawEllipse(QPointF(8, 8), 2, 2)

    return drawn_icon(paint)


def fill_table(
    table, headings: list[str], rows: list[tuple], wide: int, least: int = LEAST_ROWS, most: int = MOST_ROWS
) -> None:
    """Write texts into a table; the column `wide` takes what width is left."""
    table.setColumnCount(len(headings))
    table.setHorizontalHeaderLabels(headings)
    table.setRowCount(len(rows))
    table.verticalHeader().hide()
    header = table.horizontalHeader()
    row, title = table.verticalHeader().defaultSectionSize(), header.sizeHint().height() if any(headings) else 0
    sizes = {"row": row, "header": title, "frame": table.frameWidth()}
    table.setFixedHeight(tableHeight(len(rows), **sizes, least=least, most=most))
    for column in range(len(headings)):
        header.setSectionResizeMode(column, QHeaderView.ResizeToContents)
    header.setSectionResizeMode(wide, QHeaderView.Stretch)
    for row, texts in enumerate(rows):
        for column, text in enumerate(texts):
            table.setItem(row, column, QTableWidgetItem(text))


def fill_stacks(panel: QWidget, stacks: Sequence[tuple]) -> None:
    """List further stacks, or show no list where there are none."""
    label, table = (panel.findChild(QWidget, name) for name in ("furtherStacksLabel", "furtherStacksTable"))
    for widget in (label, table):
        widget.setVisible(bool(stacks))
    fill_table(table, ["", "", ""], [("", result, "") for _, _, result in stacks], wide=0, least=1, most=STACK_ROWS)
    table.horizontalHeader().hide()
    table.setColumnHidden(2, not any(result for _, _, result in stacks))
    for row, (name, ticked, _) in enumerate(stacks):
        check, align = QCheckBox(name), QToolButton()
        check.setChecked(ticked)
        align.setText("Align")
        table.setCellWidget(row, 0, check)
        table.setCellWidget(row, 2, align)


def fill(
    panel: QWidget,
    organs: list[tuple] = ORGANS,
    points: list[tuple] = BOUNDARY_POINTS,
    stacks: Sequence[tuple] = (),
    **texts: str,
) -> None:
    """Show the panel as it is while organs are worked on.

    Parameters
    ----------
    panel : QWidget
    organs : list of (name, colour, volume, state)
    points : list of (position, deviation)
    stacks : sequence of (name, whether it is ticked, result)
    **texts : str
        Texts of labels in place of the usual ones, by the labels' names.
    """
    for widget in panel.findChildren(QWidget):
        if type(widget) in LOOKALIKES.values() and hasattr(widget, "finish"):
            widget.finish()
    table = panel.findChild(QWidget, "organsTable")
    rows = [("", "", name, volume, state) for name, _, volume, state in organs]
    fill_stacks(panel, stacks)
    most = organRows(min(len(stacks), STACK_ROWS))
    fill_table(table, ["", "", "Organ", "ml", "State"], rows, wide=2, most=most)
    for row, (_, color, _, _) in enumerate(organs):
        table.item(row, 0).setIcon(eye_icon())
        table.item(row, 1).setData(Qt.DecorationRole, QColor(color))
        # The verdict on the surface.
        if table.item(row, 4).text() == "fitted":
            table.item(row, 4).setData(Qt.DecorationRole, QColor("#2f9e5b"))
    table.selectRow(0)
    fill_table(panel.findChild(QWidget, "boundaryTable"), BOUNDARY_HEADINGS, points, wide=0)
    fill_table(
        panel.findChild(QWidget, "modelOrgansTable"), ["Organ of the model", "In the image"], MODEL_ORGANS, wide=1
    )
    for name, choices in CHOICES.items():
        panel.findChild(QWidget, name).addItems(choices)
    for name, text in {**optionTexts()[0], **TEXTS, **texts}.items():
        panel.findChild(QWidget, name).setText(text)
    panel.findChild(QWidget, "progressBar").setValue(100)
    # Nothing to cancel, and the organ comes from seeds, with everything automatic.
    panel.findChild(QWidget, "cancelButton").setEnabled(False)
    # A fit hides the fill.
    panel.findChild(QWidget, "previewCheck").setChecked(False)
    for name in HIDDEN:
        panel.findChild(QWidget, name).hide()


def read_panel(path: Path = PANEL) -> QWidget:
    """Read the .ui file, without the connections that only Slicer's widgets have."""
    text = re.sub(r"<connections>.*</connections>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    buffer = QBuffer()
    buffer.setData(text.encode())
    buffer.open(QBuffer.ReadOnly)
    return Loader().load(buffer)


def section_widths() -> dict[str, int]:
    """Width in pixels that each section asks for when it is open, by its title."""
    panel = read_panel()
    sections = panel.findChildren(Section)
    for section in sections:
        section.setProperty("collapsed", False)
    fill(panel)
    return {section.property("text"): section.minimumSizeHint().width() for section in sections}


def main() -> None:
    """Write the picture, and print how wide the sections are at least."""
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    QApplication.setStyle("Fusion")
    application = QApplication(sys.argv[:1])
    panel = read_panel()
    fill(panel, stacks=STACKS)
    panel.resize(WIDTH, panel.sizeHint().height())
    application.processEvents()
    picture = panel.grab(panel.rect().adjusted(0, 0, 0, -SPACER))
    PICTURE.parent.mkdir(exist_ok=True)
    if not picture.save(str(PICTURE)):
        sys.exit(f"The picture cannot be written to {PICTURE}.")
    print(PICTURE)
    for title, width in section_widths().items():
        print(f"{width} px: {title}")


if __name__ == "__main__":
    main()
