"""Further stacks of a patient: other volumes of the scene that an organ is fitted to as well.

The motion between two stacks is that of one organ, and is stored with the organ. It is stored from voxels to voxels,
so that it stays right if a volume is put under a transform later, or a transform is hardened on it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields

import numpy as np
import slicer
from slicer.i18n import tr as _

from ..messages import Diagnostic
from .points import placedIn, placedPoints
from .sentences import sentence
from .volumes import greyVolumes, gridOf, imageFromVolume, isCopyOf, linearRelation, localPoints, withSameGrid

# Node reference from a transform node that was made here to its volume.
_MOVED = "VIC.moved"
# A motion counts as rigid if its columns are orthonormal within this; stored motions are so within 1e-12.
_RIGID = 1e-4
# A stack counts as aligned if no corner would move by more than this, mm; so little cannot be seen.
_ALIGNED_MM = 0.01


@dataclass(frozen=True)
class StackRecord:
    """How a further stack was used in an organ's last fit.

    Parameters
    ----------
    used : bool
    reason : str
        Why it was not used; empty if it was.
    shift : float
        Displacement of the organ's centre from where the scene shows it, mm.
    turn : float
        Rotation of the organ, degrees.
    shiftDeviation, turnDeviation : float
        Standard deviations of both; 0 if they are not known.
    seen : float
        Share of the surface's area that lies in the stack, 0 to 1.
    cost : float
        Mean squared residual in this stack, in units of its squared contrast.
    motion : list of 16 float
        Matrix from voxels (i, j, k) of the organ's volume to those of the stack that show the same place, row by row;
        empty if no motion was found.
    """

    used: bool
    reason: str = ""
    shift: float = 0.0
    turn: float = 0.0
    shiftDeviation: float = 0.0
    turnDeviation: float = 0.0
    seen: float = 0.0
    cost: float = 0.0
    motion: tuple = ()

    @property
    def matrix(self):
        """The motion as (4, 4) ndarray, or None."""
        return np.reshape(self.motion, (4, 4)) if len(self.motion) == 16 else None


def similarVolumes(volumeNode):
    """Other volumes of the scene whose bounds overlap with those of a volume.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode or None

    Returns
    -------
    list of vtkMRMLScalarVolumeNode
        Without label maps.
    """
    if volumeNode is None:
        return []
    low, high = _bounds(volumeNode)
    found = []
    for node in greyVolumes():
        if node is volumeNode:
            continue
        otherLow, otherHigh = _bounds(node)
        if np.all(np.minimum(high, otherHigh) > np.maximum(low, otherLow)):
            found.append(node)
    return found


def stacksToFit(volumeNode, stackNodes, records=None):
    """Prepare volumes as further stacks of a fit, in the local frame of the organ's volume.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
        The organ's volume.
    stackNodes : sequence of vtkMRMLScalarVolumeNode
    records : dict of vtkMRMLScalarVolumeNode to StackRecord, optional
        Of an earlier fit, whose motions the search begins with.

    Returns
    -------
    stacks : dict of vtkMRMLScalarVolumeNode to VICRegistrationLib.registration.stacks.Stack
    leftOut : dict of vtkMRMLScalarVolumeNode to StackRecord
        Those that cannot be used, with the reason.
    """
    from ..imaging.image import Image
    from ..registration.stacks import Stack

    stacks, leftOut = {}, {}
    for node in stackNodes:
        try:
            grid, array = _gridBeside(volumeNode, node), imageFromVolume(node).array
        except ValueError as error:
            leftOut[node] = StackRecord(False, str(error))
            continue
        record = (records or {}).get(node)
        stacks[node] = Stack(Image(array, grid), node.GetName(), _startOf(record, volumeNode, grid))
    return stacks, leftOut


def keepStacks(organ, volumeNode, stackNodes, uses, leftOut):
    """Store with an organ how its further stacks were used.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode
    stackNodes : sequence of vtkMRMLScalarVolumeNode
        Those that were given to the fit, in the order of `uses`.
    uses : sequence of VICRegistrationLib.registration.stacks.StackUse
    leftOut : dict of vtkMRMLScalarVolumeNode to StackRecord
    """
    records = {node: _recordOf(use, volumeNode) for node, use in zip(stackNodes, uses)}
    _store(organ, {**records, **leftOut})


def leftOutSentences(leftOut):
    """Sentences that say which stacks were not given to a fit, and why.

    Parameters
    ----------
    leftOut : dict of vtkMRMLScalarVolumeNode to StackRecord

    Returns
    -------
    list of str
    """
    return [
        sentence(Diagnostic("stack_left_out", {"stack": node.GetName(), "reason": record.reason}))
        for node, record in leftOut.items()
    ]


def stacksOf(organ):
    """Return how the further stacks were used in an organ's last fit.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    dict of vtkMRMLScalarVolumeNode to StackRecord
        Only of volumes that are still in the scene.
    """
    found = {}
    for node, text in zip(organ.stackVolumes, organ.stackRecords):
        if node is not None and node.GetScene() is not None:
            found[node] = _recordIn(text)
    return found


def forgetRemovedStacks(organ):
    """Delete the records of further stacks that were removed from the scene.

    Parameters
    ----------
    organ : OrganParameters
    """
    kept = stacksOf(organ)
    if len(kept) != len(organ.stackRecords):
        _store(organ, kept)


def toStack(record, volumeNode, stackNode):
    """Matrix from places in the organ's volume to where a stack shows them.

    Parameters
    ----------
    record : StackRecord
    volumeNode, stackNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    (4, 4) ndarray
        From the local RAS mm of the volume to that of the stack.
    """
    return gridOf(stackNode) @ record.matrix @ np.linalg.inv(gridOf(volumeNode))


def wallPoints(organ, volumeNode):
    """Boundary points of an organ in its volume.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    (n, 3) ndarray
        Local RAS mm. A point that was placed in a slice view of a further stack lies on the wall in that stack; the
        motion that the last fit found brings it to the wall in the volume.
    """
    positions, records = placedPoints(organ.boundaryPoints), stacksOf(organ)
    points = localPoints(volumeNode, positions)
    for row, (shown, position) in enumerate(zip(placedIn(organ.boundaryPoints), positions)):
        node = withSameGrid(shown, [volumeNode, *records])
        if node in records and records[node].used:
            there = localPoints(node, position)
            back = np.linalg.inv(toStack(records[node], volumeNode, node))
            points[row] = back[:3, :3] @ there[0] + back[:3, 3]
    return points


def canBeAligned(record, volumeNode, stackNode):
    """Whether a linear transform of a stack would bring the organ in it onto the organ in its volume.

    Parameters
    ----------
    record : StackRecord
    volumeNode, stackNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    bool
        False if the stack was not used, or is aligned already.
    """
    relation = linearRelation(volumeNode.GetParentTransformNode(), stackNode.GetParentTransformNode())
    if not record.used or relation is None:
        return False
    corners = _corners(stackNode)
    moved = relation @ np.linalg.inv(toStack(record, volumeNode, stackNode))
    return bool(np.abs(corners @ moved[:3, :3].T + moved[:3, 3] - corners).max() > _ALIGNED_MM)


def alignStack(record, volumeNode, stackNode):
    """Put a stack under a transform node that undoes its motion: both volumes then show the organ in one place.

    Parameters
    ----------
    record : StackRecord
        With a motion.
    volumeNode, stackNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLLinearTransformNode
        Below the transform that the stack was under. A node that was made here earlier is reused.

    Raises
    ------
    ValueError
        If the transform between the two volumes is nonlinear.
    """
    made = stackNode.GetParentTransformNode()
    reused = _isAligned(stackNode)
    above = made.GetParentTransformNode() if reused else made
    relation = linearRelation(volumeNode.GetParentTransformNode(), above)
    if relation is None:
        raise ValueError(_nonlinear(volumeNode, stackNode))
    matrix = relation @ np.linalg.inv(toStack(record, volumeNode, stackNode))
    if not reused:
        name = slicer.mrmlScene.GenerateUniqueName(_("{volume} motion").format(volume=stackNode.GetName()))
        made = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", name)
        made.SetNodeReferenceID(_MOVED, stackNode.GetID())
        made.SetAndObserveTransformNodeID(above.GetID() if above is not None else None)
    made.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(matrix))
    stackNode.SetAndObserveTransformNodeID(made.GetID())
    return made


def alignCopy(volumeNode):
    """Put a copy of an aligned stack under the transform that has aligned the stack.

    "Clone" in Slicer's module Data leaves the transform out: the copy would show the organ where it was before.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
        A volume that was just added to the scene. If it is no copy, or is under a transform, nothing is done.
    """
    if volumeNode.GetParentTransformNode() is not None:
        return
    stack = next((node for node in greyVolumes() if _isAligned(node) and isCopyOf(volumeNode, node)), None)
    if stack is not None:
        volumeNode.SetAndObserveTransformNodeID(stack.GetParentTransformNode().GetID())


def _isAligned(stackNode):
    """Whether a volume is under a transform node that :func:`alignStack` made for it."""
    parent = stackNode.GetParentTransformNode()
    return parent is not None and parent.GetNodeReference(_MOVED) is stackNode


def _gridBeside(volumeNode, stackNode):
    """Matrix from voxels of a stack to the local RAS mm of another volume, as the scene shows both."""
    relation = linearRelation(volumeNode.GetParentTransformNode(), stackNode.GetParentTransformNode())
    if relation is None:
        raise ValueError(_nonlinear(volumeNode, stackNode))
    return np.linalg.inv(relation) @ gridOf(stackNode)


def _nonlinear(volumeNode, stackNode):
    return _("The transform between {stack} and {volume} is nonlinear. Harden it on the volume, or remove it.").format(
        stack=stackNode.GetName(), volume=volumeNode.GetName()
    )


def _startOf(record, volumeNode, grid):
    """Motion (4, 4) of an earlier fit, for the present places of both volumes; the identity if it is not rigid."""
    if record is None or record.matrix is None or not record.used:
        return np.eye(4)
    moved = grid @ record.matrix @ np.linalg.inv(gridOf(volumeNode))
    rotation = moved[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > _RIGID or np.linalg.det(rotation) < 0.0:
        # One of the volumes was stretched since.
        return np.eye(4)
    start = np.eye(4)
    start[:3] = moved[:3]
    return start


def _recordOf(use, volumeNode):
    motion = np.linalg.inv(use.image.ijk_to_ras) @ use.motion @ gridOf(volumeNode)
    return StackRecord(
        used=bool(use.used),
        reason=sentence(use.reason) if use.reason is not None else "",
        shift=float(np.linalg.norm(use.translation_mm)),
        turn=float(use.rotation_degrees),
        # JSON knows neither nan nor infinity.
        shiftDeviation=float(np.nan_to_num(use.translation_sd_mm)),
        turnDeviation=float(np.nan_to_num(use.rotation_sd_degrees)),
        seen=float(use.seen),
        cost=float(use.cost) if np.isfinite(use.cost) else -1.0,
        motion=tuple(motion.ravel().tolist()),
    )


def _recordIn(text):
    """Record that a scene holds; fields of other versions are left out."""
    known = {field.name for field in fields(StackRecord)}
    return StackRecord(**{name: value for name, value in json.loads(text).items() if name in known})


def _store(organ, records):
    texts = [json.dumps(asdict(record)) for record in records.values()]
    if list(organ.stackVolumes) == list(records) and list(organ.stackRecords) == texts:
        return
    with slicer.util.NodeModify(organ.parameterNode):
        organ.stackVolumes, organ.stackRecords = list(records), texts


def _corners(volumeNode):
    """Corners of a volume's grid in its local RAS mm, (8, 3)."""
    data = volumeNode.GetImageData()
    size = np.array(data.GetDimensions() if data is not None else (1, 1, 1)) - 1.0
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3) * size
    grid = gridOf(volumeNode)
    return corners @ grid[:3, :3].T + grid[:3, 3]


def _bounds(volumeNode):
    """Lowest and highest corner of a volume in the world, RAS mm; the lowest is above the highest without voxels."""
    bounds = [0.0] * 6
    volumeNode.GetRASBounds(bounds)
    return np.array(bounds[::2]), np.array(bounds[1::2])
