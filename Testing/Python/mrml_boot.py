"""Boots the real MRML library of Slicer (package slicer-core) in a plain Python, once per process.

The file is not named after the package: this folder comes first in the path of a test run, and a file slicer_core.py
here would be taken for the package itself.
"""

from __future__ import annotations

import functools
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

# Name of the module in slicer.modules: its logic. The first of them must come before those that use it.
LOGICS = {
    "colors": "vtkSlicerColorLogic",
    "volumes": "vtkSlicerVolumesLogic",
    "models": "vtkSlicerModelsLogic",
    "transforms": "vtkSlicerTransformLogic",
    "markups": "vtkSlicerMarkupsLogic",
    "tables": "vtkSlicerTablesLogic",
    "plots": "vtkSlicerPlotsLogic",
    "subjecthierarchy": "vtkSlicerSubjectHierarchyModuleLogic",
    "segmentations": "vtkSlicerSegmentationsModuleLogic",
}

# Nodes that Slicer's plugins of the subject hierarchy, which are Qt, put into it.
LISTED = (
    "vtkMRMLVolumeNode",
    "vtkMRMLModelNode",
    "vtkMRMLMarkupsNode",
    "vtkMRMLSegmentationNode",
    "vtkMRMLTransformNode",
    "vtkMRMLTableNode",
    "vtkMRMLPlotSeriesNode",
    "vtkMRMLPlotChartNode",
    "vtkMRMLTextNode",
)

# What tests add and closing a scene keeps.
SINGLETONS = (
    "vtkMRMLScriptedModuleNode",
    "vtkMRMLAbstractViewNode",
    "vtkMRMLSliceCompositeNode",
    "vtkMRMLCameraNode",
)

COLOURS = {
    "GenericColors": ((0.0, 0.5, 1.0), (1.0, 0.5, 0.0)),
    "Viridis": ((0.27, 0.0, 0.33), (0.23, 0.32, 0.55), (0.13, 0.57, 0.55), (0.37, 0.79, 0.38), (0.99, 0.91, 0.14)),
    "DivergingBlueRed": ((0.23, 0.30, 0.75), (0.87, 0.87, 0.87), (0.71, 0.02, 0.15)),
}


@dataclass(frozen=True)
class Mrml:
    """What keeps the scene alive: the application's logic and those of the modules."""

    scene: object
    application: object
    logics: dict = field(default_factory=dict)
    keep: tuple = ()

    @property
    def temporary(self):
        """Folder for unpacking scene bundles, removed at the end of the process."""
        return Path(self.keep[0].name)


@functools.cache
def boot():
    """Make slicer.mrmlScene with everything Slicer's core modules register in it.

    Raises
    ------
    ImportError
        If the package slicer-core is not installed.
    """
    import slicer
    import vtk

    scene, application = slicer.vtkMRMLScene(), slicer.vtkSlicerApplicationLogic()
    slicer.mrmlScene = scene
    application.SetMRMLScene(scene)
    application.SetSliceLogics(vtk.vtkCollection())
    application.SetViewLogics(vtk.vtkCollection())
    # The colour logic complains that there is no installation of Slicer to take colour files from.
    vtk.vtkObject.GlobalWarningDisplayOff()
    application.GetColorLogic().AddDefaultColorNodes()
    _colour_files(scene)
    logics = {name: _logic(application, scene, name, getattr(slicer, cls)) for name, cls in LOGICS.items()}
    vtk.vtkObject.GlobalWarningDisplayOn()
    _follow_nodes(scene)
    return Mrml(scene, application, logics, _file_access(application, scene))


def clear(scene):
    """Empty the scene as at the start of Slicer.

    Unlike closing the scene in Slicer, which keeps singleton nodes with their values reset, this removes the parameter
    nodes of modules and the views too. Otherwise the view "Red" of a test finds that of another test beside it.
    """
    scene.Clear(0)
    for name in SINGLETONS:
        nodes = scene.GetNodesByClass(name)
        nodes.UnRegister(None)
        for node in [nodes.GetItemAsObject(i) for i in range(nodes.GetNumberOfItems())]:
            scene.RemoveNode(node)


def _logic(application, scene, name, cls):
    logic = cls()
    logic.SetMRMLApplicationLogic(application)
    logic.SetMRMLScene(scene)
    application.SetModuleLogic(name.capitalize(), logic)
    return logic


def _follow_nodes(scene):
    """Give data nodes their items in the subject hierarchy, as the plugins do."""
    import slicer
    import vtk

    def add(node):
        hierarchy = scene.GetSubjectHierarchyNode()
        listed = not node.GetHideFromEditors() and any(node.IsA(name) for name in LISTED)
        if listed and not scene.IsImporting() and not hierarchy.GetItemByDataNode(node):
            hierarchy.CreateItem(hierarchy.GetSceneItemID(), node)

    @vtk.calldata_type(vtk.VTK_OBJECT)
    def added(caller, event, node):
        add(node)

    @vtk.calldata_type(vtk.VTK_OBJECT)
    def removed(caller, event, node):
        # Hierarchies are merged when a scene is loaded on top of another.
        if node.IsA("vtkMRMLSubjectHierarchyNode"):
            return
        hierarchy = scene.GetSubjectHierarchyNode()
        item = hierarchy.GetItemByDataNode(node) if hierarchy else 0
        if item and not scene.IsClosing():
            hierarchy.RemoveItem(item, False, False)

    def imported(caller, event):
        for node in slicer.util.getNodesByClass("vtkMRMLNode"):
            add(node)

    scene.AddObserver(scene.NodeAddedEvent, added)
    scene.AddObserver(scene.NodeAboutToBeRemovedEvent, removed)
    scene.AddObserver(scene.EndImportEvent, imported)


def _colour_files(scene):
    """The colour tables of Slicer's installation that are referred to, made of a few of their colours."""
    import slicer
    import vtk

    for name, colours in COLOURS.items():
        blended = vtk.vtkColorTransferFunction()
        for index, colour in enumerate(colours):
            blended.AddRGBPoint(255 * index / (len(colours) - 1), *colour)
        node = slicer.vtkMRMLColorTableNode()
        node.SetTypeToFile()
        node.SetName(name)
        node.SetSingletonTag(f"File{name}.txt")
        node.SetSaveWithScene(False)
        node.SetNumberOfColors(256)
        for index in range(256):
            node.SetColor(index, str(index), *blended.GetColor(index), 1.0)
        scene.AddNode(node)


def _file_access(application, scene):
    """Without these two, reading a .mrb crashes."""
    import slicer

    folder = tempfile.TemporaryDirectory(prefix="mrml")
    remote, manager = slicer.vtkMRMLRemoteIOLogic(), slicer.vtkDataIOManagerLogic()
    manager.SetMRMLApplicationLogic(application)
    remote.GetCacheManager().SetRemoteCacheDirectory(folder.name)
    manager.SetAndObserveDataIOManager(remote.GetDataIOManager())
    application.SetMRMLSceneDataIO(scene, remote, manager)
    application.SetTemporaryPath(folder.name)
    return folder, remote, manager
