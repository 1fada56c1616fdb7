"""Comparing the surface of an organ with a reference: figures in a table, distances as colours."""

from __future__ import annotations

import slicer
from slicer.i18n import tr as _

from .colors import DEVIATION, addScalars, colorBy
from .comparison_table import addComparison
from .references import referenceFor, referenceName
from .surfaces import surfaceOf

_PATIENT_ATTRIBUTE = "VIC.patient"
# In the field data of the surface's triangles: a new surface comes without it.
_TEXT = "comparison"


def compareOrgan(organ, volumeNode, reference, segmentId="", *, patient=None):
    """Compare an organ with a reference; the organ is coloured by the distances, and the table gets a row.

    Parameters
    ----------
    organ : OrganParameters
        The reference is stored in it.
    volumeNode : vtkMRMLScalarVolumeNode or None
        Its name stands for the patient where none is given.
    reference : vtkMRMLSegmentationNode or vtkMRMLModelNode
    segmentId : str
        ID of the segment in a segmentation.
    patient : str, optional

    Returns
    -------
    VICRegistrationLib.analysis.comparison.Comparison
        In mm of the surface's local frame.

    Raises
    ------
    ValueError
        If there is no surface or no reference, the reference is not closed, or the two do not overlap; nothing is
        changed then.
    """
    from ..analysis.comparison import compare, distances_from

    surface = surfaceOf(organ)
    found = referenceFor(organ.surface, reference, segmentId)
    name = referenceName(reference, segmentId)
    try:
        comparison = compare(surface, found)
    except ValueError as error:
        msg = f"{name}: {error}"
        raise ValueError(msg) from error
    _checkOverlap(comparison, organ, name)
    data = organ.surface.GetPolyData()
    addScalars(data, DEVIATION, distances_from(found, slicer.util.arrayFromModelPoints(organ.surface)))
    _setText(data, "\n".join([_summary(comparison, name), *_warnings(found)]))
    colorBy(organ.surface, DEVIATION)
    patient = patient or patientOf(volumeNode)
    addComparison(comparison, patient=patient, organ=organ.label, reference=name)
    with slicer.util.NodeModify(organ.parameterNode):
        organ.setReference(reference, segmentId)
        # Its surface is another node's: the panel, which observes this one, would not notice the new distances.
        organ.parameterNode.Modified()
    return comparison


def comparisonText(organ):
    """Describe the last comparison of an organ's surface.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    str
        Empty if the surface was not compared since it was fitted.
    """
    data = organ.surface.GetPolyData() if organ.surface is not None else None
    text = data.GetFieldData().GetAbstractArray(_TEXT) if data is not None else None
    return text.GetValue(0) if text is not None and text.GetNumberOfValues() else ""


def patientOf(volumeNode):
    """Name of the patient of a volume.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None

    Returns
    -------
    str
        The volume's own name if no other one was given; empty without a volume.
    """
    return (volumeNode.GetAttribute(_PATIENT_ATTRIBUTE) or volumeNode.GetName()) if volumeNode is not None else ""


def setPatient(volumeNode, name):
    """Store the name of the patient with a volume.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    name : str
        A blank one stands for the volume's own name.
    """
    name = name.strip()
    if name and name != volumeNode.GetName():
        volumeNode.SetAttribute(_PATIENT_ATTRIBUTE, name)
    else:
        volumeNode.RemoveAttribute(_PATIENT_ATTRIBUTE)


def _checkOverlap(comparison, organ, name):
    if comparison.volume_dice > 0.0:
        return
    raise ValueError(
        _(
            "The surface of {organ} and {reference} do not overlap: they are {distance} mm apart. A reference of the "
            "same organ is needed. Choose another one, or check the transforms of both."
        ).format(organ=organ.label, reference=name, distance=f"{min(abs(comparison.signed_to_reference)):.1f}")
    )


def _summary(comparison, name):
    deviation = comparison.to_surface
    return "\n".join(
        [
            _("Against {reference}:").format(reference=name),
            _("mean {mean} mm (signed {signed}), 95 % {p95} mm, Hausdorff {hausdorff} mm, Dice {dice}").format(
                mean=f"{deviation.mean:.2f}",
                signed=f"{deviation.mean_signed:+.2f}",
                p95=f"{deviation.p95:.2f}",
                hausdorff=f"{comparison.hausdorff:.2f}",
                dice=f"{comparison.volume_dice:.3f}",
            ),
            _("volume {volume} ml, reference {reference} ml").format(
                volume=f"{comparison.volume_ml:.1f}", reference=f"{comparison.reference_ml:.1f}"
            ),
        ]
    )


def _warnings(reference):
    """Warn if the reference has several pieces, which make distances look larger than they are."""
    from ..analysis.reference_meshes import closed_mesh, pieces
    from ..geometry.surface import BSplineSurface

    count = 1 if isinstance(reference, BSplineSurface) else len(pieces(closed_mesh(reference)))
    if count == 1:
        return []
    return [
        _(
            "The reference has {count} pieces or cavities, and all of them count. The effect Islands of Segment Editor "
            "removes those that do not belong to the organ."
        ).format(count=count)
    ]


def _setText(data, text):
    from ..export.surface_data import add_text

    add_text(data, _TEXT, text)
