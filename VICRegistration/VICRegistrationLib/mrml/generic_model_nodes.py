"""A fitted generic model in the scene: a folder with a text node that holds it exactly, and a model node for each part.

The text is the JSON file of the model in the local frame of its volume. The model nodes are triangles of the parts,
under the volume's parent transform. If a transform was hardened on them, they tell where the model lies.
"""

from __future__ import annotations

import numpy as np
import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import vtk_to_numpy

from .organ_nodes import createFolder, removeNodes
from .organs import storable
from .regions import TYPE_ATTRIBUTE
from .surfaces import affineMap, createModel
from .volumes import VOLUME, linearRelation, putUnderVolume

_TYPE = "generic model"
# Attributes of the text and of a part.
_MESSAGE, _PART = "VIC.message", "VIC.part"
# Numbers of the triangles' patches, from 1.
_PATCH = "patch_number"
# Opacity of estimated parts, as in the pictures of models.
_TRANSLUCENT = 0.35


def showModel(volumeNode, model, message):
    """Show a fitted model of a volume; it replaces an earlier one.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    model : VICRegistrationLib.multipatch.model.MultiPatchModel
        Local RAS mm of the volume.
    message : str
        Summary and warnings of its fit.

    Returns
    -------
    vtkMRMLTextNode
    """
    from ..multipatch.colours import part_colours
    from ..multipatch.file import model_text
    from ..multipatch.vtp import part_polydata
    from ..organ_colours import rgb

    text, triangles = model_text(model), part_polydata(model)
    colors, byPatch = part_colours(model), isColoredByPatch(volumeNode)
    textNode = findModel(volumeNode) or _createText(volumeNode)
    earlier = {node.GetAttribute(_PART): node for node in partsOf(volumeNode)}
    removeNodes([node for name, node in earlier.items() if name not in triangles])
    textNode.SetText(text)
    textNode.SetAttribute(_MESSAGE, message)
    for part in model.parts:
        node = earlier.get(part.name) or _createPart(volumeNode, part.name)
        _putBeside(textNode, node)
        node.SetName(_nameOf(part))
        node.SetAndObservePolyData(_withNormals(triangles[part.name]))
        putUnderVolume(node, volumeNode)
        display = node.GetDisplayNode()
        display.SetColor(*rgb(colors[part.name]))
        display.SetOpacity(_TRANSLUCENT if part.estimated else 1.0)
        display.SetBackfaceCulling(False)
    _showPatchColors(volumeNode, model)
    colorByPatch(volumeNode, byPatch)
    return textNode


def findModel(volumeNode):
    """Text node that holds the fitted model of a volume, if there is one.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None

    Returns
    -------
    vtkMRMLTextNode or None
    """
    nodes = _belonging("vtkMRMLTextNode", volumeNode)
    return next((node for node in nodes if node.GetAttribute(TYPE_ATTRIBUTE) == _TYPE), None)


def messageOf(volumeNode):
    """Summary and warnings of the fitted model of a volume.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None

    Returns
    -------
    str
        Empty if there is none.
    """
    textNode = findModel(volumeNode)
    return (textNode.GetAttribute(_MESSAGE) or "") if textNode is not None else ""


def partsOf(volumeNode):
    """Model nodes of the parts of a fitted model that are still in the scene.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None

    Returns
    -------
    list of vtkMRMLModelNode
    """
    return [node for node in _belonging("vtkMRMLModelNode", volumeNode) if node.GetAttribute(_PART) is not None]


def colorByPatch(volumeNode, byPatch):
    """Show the patches of a fitted model in different shades, or every part in one colour.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None
    byPatch : bool
    """
    table = _patchColors(volumeNode)
    for node in partsOf(volumeNode):
        display = node.GetDisplayNode()
        if display is None:
            continue
        with slicer.util.NodeModify(display):
            if byPatch and table is not None:
                display.SetActiveScalar(_PATCH, vtk.vtkAssignAttribute.CELL_DATA)
                display.SetAndObserveColorNodeID(table.GetID())
                # The range of the colour table would be lost if somebody deletes the table.
                display.SetScalarRangeFlag(slicer.vtkMRMLDisplayNode.UseManualScalarRange)
                display.SetScalarRange(0, table.GetNumberOfColors() - 1)
            display.SetScalarVisibility(byPatch and table is not None)


def isColoredByPatch(volumeNode):
    """Whether a part of the fitted model of a volume is coloured by patch.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None

    Returns
    -------
    bool
    """
    displays = [node.GetDisplayNode() for node in partsOf(volumeNode)]
    return any(
        display is not None and display.GetScalarVisibility() and display.GetActiveScalarName() == _PATCH
        for display in displays
    )


def followVolumeWithModel(volumeNode):
    """Put the parts of a fitted model under the transform that its volume is under now, or that was hardened on it.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    """
    for node in partsOf(volumeNode):
        putUnderVolume(node, volumeNode)


def modelOfVolume(volumeNode):
    """Exact fitted model of a volume, in world coordinates.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    VICRegistrationLib.multipatch.model.MultiPatchModel
        World RAS mm; bit for bit as it was fitted if no transform has moved it.

    Raises
    ------
    ValueError
        If there is none, or it was changed, or lies under a nonlinear or mirroring transform.
    """
    from ..multipatch.file import model_of_text

    textNode = findModel(volumeNode)
    if textNode is None:
        raise ValueError(_("There is no fitted model yet. Press Fit model first."))
    model = model_of_text(textNode.GetText() or "", f"text {textNode.GetName()}")
    matrix = _matrixToWorld(volumeNode) @ _hardened(model, partsOf(volumeNode))
    if np.array_equal(matrix, np.eye(4)):
        return model
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        raise ValueError(
            _("The model is under a mirroring transform, which its patches cannot follow. Remove the transform.")
        )
    moved = {name: parent.transformed(matrix) for name, parent in model.parents.items()}
    return model.carried(moved, lambda points: points @ matrix[:3, :3].T + matrix[:3, 3])


def _matrixToWorld(volumeNode):
    matrix = linearRelation(volumeNode.GetParentTransformNode(), None)
    if matrix is None:
        raise ValueError(
            _(
                "The model is under a nonlinear transform, which B-spline surfaces cannot follow exactly. Take the "
                "volume out of the transform, or harden the transform on the volume and fit the model again."
            )
        )
    return matrix


def _hardened(model, parts):
    """Affine map, (4, 4), that was hardened on the parts of a model."""
    from ..multipatch.vtp import part_polydata

    own = part_polydata(model)
    pairs = [(_points(own[node.GetAttribute(_PART)]), _points(node.GetPolyData())) for node in parts]
    if not pairs:
        return np.eye(4)
    if all(len(before) == len(now) for before, now in pairs):
        matrix = affineMap(*(np.concatenate(side) for side in zip(*pairs)))
        if matrix is not None:
            return matrix
    raise ValueError(
        _(
            "The triangles of the model's parts have been changed, by hardening a nonlinear transform or by another "
            "module; those of its patches are needed. Fit the model again."
        )
    )


def _points(data):
    if data is None or not data.GetNumberOfPoints():
        return np.zeros((0, 3))
    return vtk_to_numpy(data.GetPoints().GetData()).astype(float)


def _nameOf(part):
    """Name of a part's node, which says whether the part is predicted or estimated."""
    words = "{part}"
    if part.estimated:
        words = _("{part} (predicted)") if part.kind == "organ" else _("{part} (estimated)")
    return storable(words.format(part=part.name))


def _createText(volumeNode):
    """Make the text node, in a folder of its own beside the volume."""
    name = _("{volume} (generic model)").format(volume=volumeNode.GetName())
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTextNode", name)
    node.SetAttribute(TYPE_ATTRIBUTE, _TYPE)
    node.SetNodeReferenceID(VOLUME, volumeNode.GetID())
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    hierarchy.SetItemParent(hierarchy.GetItemByDataNode(node), createFolder(hierarchy, volumeNode, name))
    return node


def _createPart(volumeNode, name):
    node = createModel(storable(name), (0.8, 0.8, 0.8))
    node.SetAttribute(_PART, name)
    node.SetNodeReferenceID(VOLUME, volumeNode.GetID())
    return node


def _putBeside(textNode, node):
    """Put the node of a part into the folder of the text node."""
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(textNode))
    hierarchy.SetItemParent(hierarchy.GetItemByDataNode(node), folder)


def _belonging(className, volumeNode):
    """Nodes of a class that refer to a volume."""
    nodes = slicer.util.getNodesByClass(className) if volumeNode is not None else []
    return [node for node in nodes if node.GetNodeReference(VOLUME) is volumeNode]


def _withNormals(data):
    """Triangles with normals for smooth shading, and the same points."""
    normals = vtk.vtkPolyDataNormals()
    normals.SetInputData(data)
    normals.SplittingOff()
    normals.ConsistencyOff()
    normals.Update()
    return normals.GetOutput()


def _patchColors(volumeNode):
    """Colours of the patches of a fitted model by their numbers, or None."""
    return next(iter(_belonging("vtkMRMLColorTableNode", volumeNode)), None)


def _showPatchColors(volumeNode, model):
    """Put the colours and names of a model's patches into the colour table of its volume; make it if needed."""
    from ..multipatch.colours import patch_colours

    table, colors = _patchColors(volumeNode), patch_colours(model)
    if table is None:
        name = _("{volume} patches").format(volume=volumeNode.GetName())
        table = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLColorTableNode", name)
        table.SetTypeToUser()
        table.SetNodeReferenceID(VOLUME, volumeNode.GetID())
    table.SetNumberOfColors(len(model.patches) + 1)
    # Opaque: one translucent colour in the table makes all surfaces translucent.
    table.SetColor(0, _("no patch"), 0.0, 0.0, 0.0, 1.0)
    for number, patch in enumerate(model.patches, start=1):
        table.SetColor(number, patch.name, *colors[patch.name], 1.0)
    table.GetLookupTable().SetRange(0, len(model.patches))
