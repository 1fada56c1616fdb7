"""Choices for fitting a generic model: the model, which organs of the table are its organs, and landmarks on bone."""

# Without postponed annotations: Slicer reads those of the parameters.
import functools
import json
import os
from typing import Optional

import slicer
from slicer import vtkMRMLMarkupsFiducialNode
from slicer.i18n import tr as _
from slicer.parameterNodeWrapper import parameterNodeWrapper

from .points import createPoints, placedIndices
from .volumes import localPoints, putUnderVolume

# Attribute of an organ's parameter node: name of the model's organ that it is paired with, or null, as JSON.
_MODEL_ORGAN = "VIC.modelOrgan"
_LANDMARK_COLOR = (0.35, 0.85, 1.0)


@parameterNodeWrapper
class GenericModelParameters:
    """Choices for the generic model, in the module's parameter node."""

    # A name of multipatch/library.py, or the path of a file.
    modelName: str = "pelvis"
    modelLandmarks: Optional[vtkMRMLMarkupsFiducialNode]


def modelNamed(name):
    """Model of the library, or one in a file.

    Parameters
    ----------
    name : str
        As in `GenericModelParameters.modelName`.

    Returns
    -------
    VICRegistrationLib.multipatch.model.MultiPatchModel

    Raises
    ------
    ValueError
        If there is no such model.
    """
    from ..multipatch.library import MODELS

    if not name:
        raise ValueError(_("No file is chosen. Choose a model file."))
    try:
        return _foundModel(name, None if name in MODELS else os.stat(name).st_mtime_ns)
    except OSError as error:
        raise ValueError(
            _("The model {name} cannot be read ({reason}); choose a model file that exists.").format(
                name=name, reason=error.strerror or error
            )
        ) from error


@functools.lru_cache(maxsize=1)
def _foundModel(name, changed):
    """Build or read a model, once until its file is changed."""
    from ..multipatch.library import find_model

    return find_model(name)


def pairedOrgans(model, organs):
    """Pair the organs of a model with organs of the table.

    Parameters
    ----------
    model : VICRegistrationLib.multipatch.model.MultiPatchModel
    organs : iterable of OrganParameters

    Returns
    -------
    dict of str to OrganParameters
        By their names in the model; without those that are to be predicted. Where nothing was chosen, organs of the
        same name are paired, in capital or small letters.
    """
    found = {}
    for organ in organs:
        chosen = _chosenFor(organ, model)
        if chosen is not None:
            found.setdefault(chosen, organ)
    return {name: found[name] for name in model.organs if name in found}


def pairOrgan(name, organ, organs, model):
    """Pair an organ of the model with an organ of the table.

    Parameters
    ----------
    name : str
        Of the model's organ.
    organ : OrganParameters or None
        None if it is to be predicted.
    organs : iterable of OrganParameters
        All of the table.
    model : VICRegistrationLib.multipatch.model.MultiPatchModel
    """
    for other in organs:
        if other is not organ and _chosenFor(other, model) == name:
            other.parameterNode.SetAttribute(_MODEL_ORGAN, json.dumps(None))
    if organ is not None:
        organ.parameterNode.SetAttribute(_MODEL_ORGAN, json.dumps(name))


def createLandmarks(model, volumeNode):
    """Make a list of a model's landmarks, to be placed one after the other.

    Parameters
    ----------
    model : VICRegistrationLib.multipatch.model.MultiPatchModel
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLMarkupsFiducialNode
        Its points are labelled with the names of the landmarks and are not placed yet. Their number is fixed.

    Raises
    ------
    ValueError
        If the model has no landmarks.
    """
    if not model.landmarks:
        raise ValueError(_("The model has no landmarks; fit it without them."))
    name = _("{model} landmarks").format(model=model.name or _("model"))
    node = createPoints(slicer.mrmlScene.GenerateUniqueName(name), _LANDMARK_COLOR)
    node.GetDisplayNode().SetPointLabelsVisibility(True)
    putUnderVolume(node, volumeNode)
    for name in model.landmarks:
        index = node.AddControlPoint(0.0, 0.0, 0.0)
        node.SetNthControlPointLabel(index, name)
        node.UnsetNthControlPointPosition(index)
    # Clicks then place these points and add no others.
    node.SetFixedNumberOfControlPoints(True)
    return node


def nextLandmark(markupsNode):
    """Index of the landmark that the next click places.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode

    Returns
    -------
    int or None
        None where all are placed or skipped.
    """
    settled = (slicer.vtkMRMLMarkupsNode.PositionDefined, slicer.vtkMRMLMarkupsNode.PositionMissing)
    indices = range(markupsNode.GetNumberOfControlPoints())
    return next((i for i in indices if markupsNode.GetNthControlPointPositionStatus(i) not in settled), None)


def skipLandmark(markupsNode):
    """Skip the landmark that the next click would place.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode
        Nothing is done if all landmarks are placed or skipped.
    """
    index = nextLandmark(markupsNode)
    if index is not None:
        markupsNode.SetNthControlPointPositionMissing(index)


def landmarksText(markupsNode):
    """Text with the number of landmarks placed and skipped, and the name of the next one.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode

    Returns
    -------
    str
    """
    count, index = markupsNode.GetNumberOfControlPoints(), nextLandmark(markupsNode)
    placed = len(placedIndices(markupsNode))
    missing = slicer.vtkMRMLMarkupsNode.PositionMissing
    skipped = sum(markupsNode.GetNthControlPointPositionStatus(i) == missing for i in range(count))
    words = _("{placed} of {count} placed, {skipped} skipped") if skipped else _("{placed} of {count} placed")
    text = words.format(placed=placed, count=count, skipped=skipped)
    if index is None:
        return text
    return _("{text}; next: {name}").format(text=text, name=markupsNode.GetNthControlPointLabel(index))


def placedLandmarks(markupsNode, volumeNode):
    """Landmarks that were placed.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode or None
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    dict of str to (3,) ndarray
        Local RAS mm of the volume, by the labels of the points.

    Raises
    ------
    ValueError
        If two points have the same label.
    """
    found = {}
    for index in placedIndices(markupsNode):
        label = markupsNode.GetNthControlPointLabel(index)
        if label in found:
            raise ValueError(
                _("The list {list} has the landmark {label} twice; remove one of the points, or rename it.").format(
                    list=markupsNode.GetName(), label=label
                )
            )
        found[label] = localPoints(volumeNode, markupsNode.GetNthControlPointPositionWorld(index))[0]
    return found


def _chosenFor(organ, model):
    """Name of the model's organ that an organ of the table is paired with, or None."""
    text = organ.parameterNode.GetAttribute(_MODEL_ORGAN)
    if text is not None:
        chosen = json.loads(text)
        return chosen if chosen is None or chosen in model.organs else None
    return next((name for name in model.organs if name.casefold() == organ.label.casefold()), None)
