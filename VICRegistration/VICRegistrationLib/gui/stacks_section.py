"""The list of further stacks: the other volumes that organs are fitted to as well, and how each was used."""

from __future__ import annotations

import qt
import slicer
import vtk
from slicer.i18n import tr as _
from slicer.util import VTKObservationMixin

from ..mrml.organ_nodes import volumeOf
from ..mrml.stack_contours import chooseViews, followStacks
from ..mrml.stacks import alignCopy, alignStack, canBeAligned, forgetRemovedStacks, similarVolumes, stacksOf
from ..mrml.volumes import greyVolumes, isGreyVolume
from .widgets import STACK_ROWS, fitHeight, setUpTable, showRow, signalsBlocked

_NAME, _RESULT, _ALIGN = range(3)


class StacksSection(VTKObservationMixin):
    """Lists the other volumes of the scene that show the same place; the user ticks those to be used.

    Parameters
    ----------
    ui : namespace of widgets
        `furtherStacksLabel` and `furtherStacksTable`.
    onChanged : callable
        Called without arguments when volumes were added or removed.
    onCame : callable
        Called without arguments when volumes were added, and until there is an organ when a slice view has changed.
    onMoved : callable
        Called with a volume whose place in the world has changed.
    """

    def __init__(self, ui, onChanged, onCame, onMoved):
        VTKObservationMixin.__init__(self)
        self._label, self._table = ui.furtherStacksLabel, ui.furtherStacksTable
        self._onChanged, self._onCame, self._onMoved = onChanged, onCame, onMoved
        self._organs = self._own = None
        self._listed, self._records, self._moves = [], {}, VTKObservationMixin()
        # IDs of volumes that were added to the scene and may be copies of an aligned stack.
        self._added = []
        setUpTable(self._table, ["", "", ""], wide=_NAME)
        self._table.horizontalHeader().setVisible(False)
        self._table.setSelectionMode(qt.QAbstractItemView.NoSelection)
        showRow(False, self._label, self._table)
        # Later, because a volume may get its voxels after it was added to the scene.
        self._timer = qt.QTimer()
        self._timer.setSingleShot(True)
        self._timer.setInterval(0)
        self._timer.connect("timeout()", self._volumesChanged)

    @property
    def rows(self):
        """Number of rows that are visible."""
        return min(len(self._listed), STACK_ROWS)

    def open(self, organs):
        """Follow the volumes and the views of the scene.

        Parameters
        ----------
        organs : VICRegistrationLib.mrml.organs.Organs
        """
        self.stop()
        self._organs = organs
        scene = slicer.mrmlScene
        self.addObserver(scene, scene.NodeAddedEvent, self._nodeCame)
        self.addObserver(scene, scene.NodeRemovedEvent, self._nodeGone)
        self._followViews()
        self._forgetRemoved()

    def close(self):
        """List nothing; contours still follow the slice views."""
        self._timer.stop()
        self._moves.removeObservers()
        self._organs = None
        self.refresh(None, None)

    def stop(self):
        """Follow nothing any more."""
        self.close()
        self.removeObservers()

    def chosen(self):
        """Return the volumes that are ticked.

        Returns
        -------
        list of vtkMRMLScalarVolumeNode
        """
        ticked = list(self._organs.parameters.furtherStacks) if self._organs is not None else []
        return [node for node in self._listed if node in ticked]

    def refresh(self, volumeNode, organ):
        """List the volumes that show the same place as a volume, and how an organ's last fit has used them.

        Parameters
        ----------
        volumeNode : vtkMRMLScalarVolumeNode or None
        organ : OrganParameters or None
        """
        self._listed = similarVolumes(volumeNode)
        self._records = stacksOf(organ) if organ is not None else {}
        self._own = (volumeOf(organ) if organ is not None else None) or volumeNode
        showRow(bool(self._listed), self._label, self._table)
        self._table.setRowCount(len(self._listed))
        ticked = self.chosen()
        aligning = [self._fill(row, node, node in ticked) for row, node in enumerate(self._listed)]
        # Without buttons to press, the names get their place.
        self._table.setColumnHidden(_ALIGN, not any(aligning))
        fitHeight(self._table, header=False, least=1, most=STACK_ROWS)

    def _fill(self, row, node, isTicked):
        """Show a volume; returns whether it can be aligned."""
        held = self._table.item(row, _RESULT)
        if held is None or held.data(qt.Qt.UserRole) != node.GetID():
            held = qt.QTableWidgetItem()
            held.setData(qt.Qt.UserRole, node.GetID())
            self._table.setItem(row, _RESULT, held)
            self._table.setCellWidget(row, _NAME, self._check(node))
            self._table.setCellWidget(row, _ALIGN, self._alignButton(node))
        check, button = (self._table.cellWidget(row, column) for column in (_NAME, _ALIGN))
        check.text = _label(node)
        check.toolTip = _("{volume}: tick it to fit organs to this stack as well.").format(volume=node.GetName())
        with signalsBlocked(check):
            check.checked = isTicked
        record = self._records.get(node)
        held.setText(_short(record))
        held.setToolTip(_long(record, node))
        button.enabled = aligning = record is not None and canBeAligned(record, self._own, node)
        return aligning

    def _check(self, node):
        check, nodeId = qt.QCheckBox(), node.GetID()
        check.connect("toggled(bool)", lambda on: self._tick(nodeId, on))
        return check

    def _alignButton(self, node):
        button, nodeId = qt.QToolButton(), node.GetID()
        button.text = _("Align")
        button.toolTip = _("Put the stack under a transform that shows the organ in one place in both stacks.")
        button.connect("clicked()", lambda: self._align(nodeId))
        return button

    def _tick(self, nodeId, on):
        node = slicer.mrmlScene.GetNodeByID(nodeId)
        others = [one for one in self._organs.parameters.furtherStacks if one is not None and one is not node]
        self._organs.parameters.furtherStacks = [*others, node] if on else others

    def _align(self, nodeId):
        node = slicer.mrmlScene.GetNodeByID(nodeId)
        alignStack(self._records[node], self._own, node)

    def _followViews(self):
        for node in slicer.util.getNodesByClass("vtkMRMLSliceCompositeNode"):
            if not self.hasObserver(node, vtk.vtkCommand.ModifiedEvent, self._viewsChanged):
                self.addObserver(node, vtk.vtkCommand.ModifiedEvent, self._viewsChanged)
        chooseViews()

    def _viewsChanged(self, caller=None, event=None):
        if slicer.mrmlScene.IsClosing():
            return
        chooseViews()
        if self._organs is not None and not len(self._organs):
            # Until there is an organ, the panel chooses the volume that is shown.
            self._timer.start()

    @vtk.calldata_type(vtk.VTK_OBJECT)
    def _nodeCame(self, caller, event, node):
        # Label maps come and go while an organ is separated from a segment.
        isVolume = isGreyVolume(node)
        if isVolume or any(node.IsA(kind) for kind in ("vtkMRMLSliceCompositeNode", "vtkMRMLAbstractViewNode")):
            self._timer.start()
        if isVolume and not slicer.mrmlScene.IsImporting():
            self._added.append(node.GetID())
        if isVolume and self._organs is not None:
            self._follow(node)

    @vtk.calldata_type(vtk.VTK_OBJECT)
    def _nodeGone(self, caller, event, node):
        if isGreyVolume(node) and not slicer.mrmlScene.IsClosing():
            self._forgetRemoved()
            self._onChanged()

    def _volumesChanged(self):
        added, self._added = [slicer.mrmlScene.GetNodeByID(nodeId) for nodeId in self._added], []
        for node in added:
            if node is not None:
                alignCopy(node)
        self._followViews()
        self._forgetRemoved()
        self._onCame()
        self._onChanged()

    def _forgetRemoved(self):
        """Forget volumes that were removed, and follow those that are there."""
        self._moves.removeObservers()
        if self._organs is None:
            return
        parameters = self._organs.parameters
        kept = [node for node in parameters.furtherStacks if node is not None and node.GetScene() is not None]
        if kept != list(parameters.furtherStacks):
            parameters.furtherStacks = kept
        for organ in self._organs:
            forgetRemovedStacks(organ)
            followStacks(organ)
        for node in greyVolumes():
            self._follow(node)

    def _follow(self, volumeNode):
        self._moves.addObserver(volumeNode, slicer.vtkMRMLTransformableNode.TransformModifiedEvent, self._moved)
        self._moves.addObserver(volumeNode, vtk.vtkCommand.ModifiedEvent, self._renamed)

    def _renamed(self, caller, event=None):
        """Show the name of a volume that was changed; it may have been renamed."""
        if caller in self._listed:
            self._table.cellWidget(self._listed.index(caller), _NAME).text = _label(caller)

    def _moved(self, caller, event=None):
        self._onMoved(caller)


def _label(node):
    """Name of a volume as the text of a button, where an ampersand would underline the next letter."""
    return (node.GetName() or "").replace("&", "&&")


def _short(record):
    """Text of the cell that tells how a stack was used."""
    if record is None:
        return ""
    if not record.used:
        return _("left out")
    return _("{shift} mm, {turn}°").format(shift=f"{record.shift:.1f}", turn=f"{record.turn:.1f}")


def _long(record, node):
    """Tooltip that tells how a stack was used."""
    if record is None:
        return _("The last fit of the selected organ did not use this stack.")
    if not record.used:
        return _("The stack {stack} was left out. {reason}").format(stack=node.GetName(), reason=record.reason)
    moved = _("{shift} mm, {turn} degrees")
    # Earlier versions have not stored the standard deviations.
    if record.shiftDeviation > 0.0:
        moved = _("{shift} ± {shiftDeviation} mm, {turn} ± {turnDeviation} degrees (standard deviations)")
    moved = moved.format(
        shift=f"{record.shift:.1f}",
        shiftDeviation=f"{record.shiftDeviation:.1g}",
        turn=f"{record.turn:.1f}",
        turnDeviation=f"{record.turnDeviation:.1g}",
    )
    return _("{stack}: used, moved {moved}. It shows {seen} % of the surface, with a cost of {cost}.").format(
        stack=node.GetName(), moved=moved, seen=f"{100 * record.seen:.0f}", cost=f"{record.cost:.3g}"
    )
