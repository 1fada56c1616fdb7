"""The table of organs: shown or hidden, colour, name, volume, state."""

from __future__ import annotations

import ctk
import qt
import slicer
from slicer.i18n import tr as _

from ..mrml.organ_nodes import isVisible, paint, setVisible
from ..mrml.organs import PRESETS
from .widgets import MOST_ROWS, fitHeight, organRows, setUpTable, signalsBlocked

_EYE, _COLOR, _NAME, _VOLUME, _STATE = range(5)
# Square beside the state by the verdict on the surface: a background would not be seen in the row that is selected.
_VERDICT_COLOURS = {"good": "#2f9e5b", "check": "#f0a818", "poor": "#d0202a"}
_ICONS = {True: ":/Icons/Small/SlicerVisible.png", False: ":/Icons/Small/SlicerInvisible.png"}


class OrgansTable:
    """Adds, renames, colours, shows, chooses and removes organs.

    Parameters
    ----------
    ui : namespace of widgets
        `organsTable`, `presetCombo`, `addOrganButton` and `removeOrganButton`.
    onAdd, onRemove : callable
        Called with a name, and with nothing.
    onChoose : callable
        Called with an organ's node.
    """

    def __init__(self, ui, onAdd, onRemove, onChoose):
        self._table, self._preset = ui.organsTable, ui.presetCombo
        self._remove = ui.removeOrganButton
        self._organs, self._mostRows = None, MOST_ROWS
        self._onAdd, self._onChoose = onAdd, onChoose
        self._setUpTable()
        for name in PRESETS:
            self._preset.addItem(_(name), name)
        self._preset.addItem(_("other"), "organ")
        ui.addOrganButton.connect("clicked()", self._add)
        ui.removeOrganButton.connect("clicked()", onRemove)
        self._table.connect("itemSelectionChanged()", self._chosen)
        self._table.connect("itemChanged(QTableWidgetItem*)", self._renamed)

    def show(self, organs):
        """Fill the table.

        Parameters
        ----------
        organs : VICRegistrationLib.mrml.organs.Organs or None
        """
        self._organs = organs
        listed = list(organs) if organs is not None else []
        current = organs.current() if organs is not None else None
        with signalsBlocked(self._table):
            self._table.setRowCount(len(listed))
            for row, organ in enumerate(listed):
                self._fill(row, organ)
            if current is None:
                self._table.clearSelection()
            else:
                self._select(listed.index(current))
        fitHeight(self._table, most=self._mostRows)
        self._remove.enabled = current is not None

    def leaveRoom(self, rows):
        """Show fewer rows, so that another list fits under the volume; see :func:`.widgets.organRows`.

        Parameters
        ----------
        rows : int
            Of the other list.
        """
        self._mostRows = organRows(rows)

    def _setUpTable(self):
        table = self._table
        setUpTable(table, ["", "", _("Organ"), _("ml"), _("State")], wide=_NAME)
        table.setSelectionBehavior(qt.QAbstractItemView.SelectRows)
        table.setSelectionMode(qt.QAbstractItemView.SingleSelection)
        table.setEditTriggers(qt.QAbstractItemView.DoubleClicked | qt.QAbstractItemView.EditKeyPressed)

    def _fill(self, row, organ):
        node = organ.parameterNode
        held = self._table.item(row, _NAME)
        if held is None or held.data(qt.Qt.UserRole) != node.GetID():
            self._table.setCellWidget(row, _EYE, self._eye(node))
            self._table.setCellWidget(row, _COLOR, self._colorButton(node))
            for column in (_NAME, _VOLUME, _STATE):
                item = qt.QTableWidgetItem()
                item.setData(qt.Qt.UserRole, node.GetID())
                flags = qt.Qt.ItemIsSelectable | qt.Qt.ItemIsEnabled
                item.setFlags(flags | qt.Qt.ItemIsEditable if column == _NAME else flags)
                self._table.setItem(row, column, item)
        visible = isVisible(organ)
        eye = self._table.cellWidget(row, _EYE)
        with signalsBlocked(eye):
            eye.checked = visible
        eye.setIcon(qt.QIcon(_ICONS[visible]))
        color = self._table.cellWidget(row, _COLOR)
        with signalsBlocked(color):
            color.color = qt.QColor.fromRgbF(*organ.color)
        texts = (organ.label, f"{organ.volumeMl:.1f}" if organ.volumeMl > 0 else "", organ.state.label())
        for column, text in zip((_NAME, _VOLUME, _STATE), texts):
            item = self._table.item(row, column)
            if item.text() != text:
                item.setText(text)
            item.setToolTip(organ.message)
        self._showVerdict(self._table.item(row, _STATE), organ)

    @staticmethod
    def _showVerdict(item, organ):
        """Show the verdict on the surface as a colour beside the state, and its reasons as a tooltip."""
        verdict = organ.verdict if organ.surface is not None else ""
        colour = _VERDICT_COLOURS.get(verdict)
        item.setData(qt.Qt.DecorationRole, qt.QColor(colour) if colour else None)
        if verdict:
            words = {"good": _("good"), "check": _("check"), "poor": _("poor")}
            item.setToolTip("\n".join([_("Verdict: {word}").format(word=words[verdict]), organ.verdictReasons]).strip())

    def _select(self, row):
        # A row that is selected again loses the name that is being typed in it.
        item = self._table.item(row, _NAME)
        if self._table.currentRow() != row or not item.isSelected():
            self._table.selectRow(row)

    def _eye(self, node):
        button = qt.QToolButton()
        button.setCheckable(True)
        button.setAutoRaise(True)
        button.setToolTip(_("Show or hide the organ in all views"))
        nodeId = node.GetID()
        button.connect("toggled(bool)", lambda on: self._withOrgan(nodeId, lambda organ: setVisible(organ, on)))
        return button

    def _colorButton(self, node):
        button = ctk.ctkColorPickerButton()
        button.displayColorName = False
        button.setToolTip(_("Colour of the organ"))
        nodeId = node.GetID()
        button.connect("colorChanged(QColor)", lambda color: self._withOrgan(nodeId, lambda o: _recolor(o, color)))
        return button

    def _withOrgan(self, nodeId, act):
        """Do something with the organ of a row, which may have gone, and show what came of it."""
        node = slicer.mrmlScene.GetNodeByID(nodeId)
        if node is None or self._organs is None:
            return
        act(self._organs.of(node))
        self.show(self._organs)

    def _add(self):
        self._onAdd(self._preset.itemData(self._preset.currentIndex))

    def _chosen(self):
        item = self._table.item(self._table.currentRow(), _NAME)
        node = slicer.mrmlScene.GetNodeByID(item.data(qt.Qt.UserRole)) if item is not None else None
        if node is not None:
            self._onChoose(node)

    def _renamed(self, item):
        if item.column() == _NAME:
            text = item.text()
            self._withOrgan(item.data(qt.Qt.UserRole), lambda organ: self._organs.rename(organ, text))


def _recolor(organ, color):
    organ.color = (color.redF(), color.greenF(), color.blueF())
    paint(organ)
