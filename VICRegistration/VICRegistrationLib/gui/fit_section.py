"""The section in which organs are fitted: start, progress, cancel, and the plot of the cost."""

from __future__ import annotations

import slicer
from slicer.i18n import tr as _

from ..mrml.fitting import fitSteps, refitSteps
from ..mrml.organ_nodes import setRegionVisible
from ..mrml.surfaces import moveSurface
from .message_label import MessageLabel
from .runner import StepRunner

# Attribute of a volume whose first surface the 3D views have been focused on.
_FOCUSED = "VIC.focused"
_PLOT_NAME, _PLOT_HEIGHT = "VICRegistration", 220
# Share of the remaining progress bar that is left after each stage. The number of stages is not known in advance: a
# third of the bar is left after the four stages of a given net, a twentieth after the ten up to the finest net.
_LEFT_AFTER_STAGE = 0.75


class FitSection:
    """Fits one organ after the other while the panel stays responsive.

    Parameters
    ----------
    ui : namespace of widgets
    onFit : callable
        Called without arguments when "Fit organ" is pressed.
    onFitAll : callable
        Called without arguments when "Fit all" is pressed.
    onChanged : callable
        Called without arguments when a fit has begun or ended.
    """

    def __init__(self, ui, onFit, onFitAll, onChanged):
        self._ui, self._onChanged = ui, onChanged
        self._queue, self._runner, self._organ, self._volume = [], None, None, None
        self._message = MessageLabel(ui.fitStatusLabel)
        self._stages, self._plotView, self._shown = set(), None, None
        ui.fitButton.connect("clicked()", onFit)
        ui.fitAllButton.connect("clicked()", onFitAll)
        ui.cancelButton.connect("clicked()", self.cancel)
        ui.convergenceCheck.connect("toggled(bool)", self._showPlot)
        ui.plotFrame.visible = False
        ui.progressBar.value = 0

    @property
    def running(self):
        """Whether a fit is under way."""
        return self._runner is not None

    def setOrgan(self, organ, volumeNode):
        """Show the result of an organ's last fit, or what to do first.

        Parameters
        ----------
        organ : OrganParameters or None
        volumeNode : vtkMRMLScalarVolumeNode or None
        """
        if not self.running:
            self._message.show((organ.message if organ is not None else "") or _firstStep(organ, volumeNode))
            self._ui.progressBar.value = 100 if organ is not None and organ.surface is not None else 0
        self._plot(organ)

    def refresh(self, *, ready):
        """Enable the buttons that can be used.

        Parameters
        ----------
        ready : bool
            Whether there is a volume and an organ.
        """
        ui = self._ui
        ui.fitButton.enabled = ui.fitAllButton.enabled = ready and not self.running
        ui.cancelButton.enabled = self.running
        ui.convergenceCheck.enabled = ready

    def fit(self, organs, volumeNode, further):
        """Fit organs from their regions, one after the other.

        Parameters
        ----------
        organs : list of OrganParameters
        volumeNode : vtkMRMLScalarVolumeNode
        further : list of vtkMRMLScalarVolumeNode
            Further stacks of the patient.
        """
        self._start(volumeNode, [(organ, fitSteps(organ, volumeNode, further)) for organ in organs])

    def refit(self, organ, volumeNode):
        """Fit an organ again from its surface, through its boundary points.

        Parameters
        ----------
        organ : OrganParameters
        volumeNode : vtkMRMLScalarVolumeNode
        """
        self._start(volumeNode, [(organ, refitSteps(organ, volumeNode))])

    def cancel(self):
        """End before the next step; the earlier surface comes back, and organs in the queue are not fitted."""
        self._queue = []
        if self._runner is not None:
            self._runner.cancel()

    def stop(self):
        """End now, because the scene or the panel is closed."""
        self._queue = []
        if self._runner is not None:
            self._runner.stop()
        self._plot(None)

    def _start(self, volumeNode, queue):
        self._volume, self._queue = volumeNode, queue
        self._next()

    def _next(self):
        # Organs that were removed while they waited are skipped.
        self._queue = [entry for entry in self._queue if entry[0].parameterNode.GetScene() is not None]
        if not self._queue:
            self._onChanged()
            return
        self._organ, steps = self._queue.pop(0)
        self._stages = set()
        self._ui.progressBar.value = 0
        self._message.show(_("{organ}: separating").format(organ=self._organ.label))
        # The filled region would cover the contour of the surface.
        setRegionVisible(self._organ, False)
        self._runner = StepRunner(steps, self._stepped, self._ended)
        self._onChanged()

    def _stepped(self, step):
        organ = self._organ
        moveSurface(organ.surface, step.surface)
        focusOnce(self._volume)
        self._ui.progressBar.value = self._percent(step)
        self._message.show(
            _("{organ}: {stage}, iteration {iteration}, cost {cost}").format(
                organ=organ.label, stage=step.stage, iteration=step.iteration, cost=f"{step.cost:.3g}"
            )
        )

    def _ended(self, problem):
        organ, self._organ, self._runner = self._organ, None, None
        self._ui.progressBar.value = 0 if problem else 100
        if not problem:
            # A fit that ends within one slice of time has shown no step.
            focusOnce(self._volume)
        there = organ.parameterNode.GetScene() is not None
        self._message.show(f"{organ.label}: {problem or organ.message}" if there else problem)
        self._plot(organ if there else None)
        self._next()

    def _percent(self, step):
        """Estimate the progress of a fit."""
        self._stages.add(step.stage)
        done = len(self._stages) - 1 + step.iteration / (step.iteration + 5.0)
        return int(100 * (1.0 - _LEFT_AFTER_STAGE**done))

    def _showPlot(self, visible):
        self._ui.plotFrame.visible = visible
        if visible and self._plotView is None:
            self._plotView = _plotViewIn(self._ui.plotFrame)
        if visible:
            self._plot(self._shown)

    def _plot(self, organ):
        """Choose the organ whose plot is shown, and show it if the plot view is there."""
        self._shown = organ
        if self._plotView is not None:
            chart = organ.plot if organ is not None else None
            _plotViewNode().SetPlotChartNodeID(chart.GetID() if chart is not None else None)


def _firstStep(organ, volumeNode):
    """Say what to do before organs can be fitted; empty if they can."""
    if volumeNode is None:
        return _("Load an MRI, or choose it in MRI volume above.")
    return "" if organ is not None else _("Press Add organ above, then click inside the organ in a slice view.")


def _plotViewNode():
    """Node of the module's own plot view, which is not part of Slicer's layout."""
    node = slicer.mrmlScene.GetSingletonNode(_PLOT_NAME, "vtkMRMLPlotViewNode")
    if node is None:
        node = slicer.mrmlScene.CreateNodeByClass("vtkMRMLPlotViewNode")
        node.UnRegister(None)
        node.SetSingletonTag(_PLOT_NAME)
        node.SetLayoutName(_PLOT_NAME)
        node = slicer.mrmlScene.AddNode(node)
        node.SetDoPropagatePlotChartSelection(False)
    return node


def focusOnce(volumeNode):
    """Centre the 3D views when a volume gets its first surface, and not again.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    """
    if volumeNode.GetAttribute(_FOCUSED):
        return
    volumeNode.SetAttribute(_FOCUSED, "1")
    layoutManager = slicer.app.layoutManager()
    if layoutManager is None:
        return
    for index in range(layoutManager.threeDViewCount):
        view = layoutManager.threeDWidget(index).threeDView()
        view.resetFocalPoint()
        view.resetCamera()


def _plotViewIn(frame):
    """Put a plot view into a frame."""
    view = slicer.qMRMLPlotView()
    view.setMRMLScene(slicer.mrmlScene)
    view.setMinimumHeight(_PLOT_HEIGHT)
    view.setMRMLPlotViewNode(_plotViewNode())
    frame.layout().addWidget(view)
    return view
