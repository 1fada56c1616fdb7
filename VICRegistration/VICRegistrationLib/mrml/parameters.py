"""What the module stores in the scene: one parameter node for the module, and one for every organ."""

# No `from __future__ import annotations`: Slicer evaluates these, and does not know `X | None`.
import enum
import math
from typing import Annotated, Optional

from slicer import (
    vtkMRMLMarkupsFiducialNode,
    vtkMRMLModelNode,
    vtkMRMLPlotChartNode,
    vtkMRMLScalarVolumeNode,
    vtkMRMLScriptedModuleNode,
    vtkMRMLSegmentationNode,
    vtkMRMLTableNode,
)
from slicer.i18n import tr as _
from slicer.parameterNodeWrapper import Default, FloatRange, RangeBounds, WithinRange, parameterNodeWrapper

from ..registration import options as table
from ..registration.options import OPTIONS, FitOptions
from .sentences import translated

# A weight of the bending energy is stored as its power of ten; this one or less stands for zero.
_NO_SMOOTHNESS = math.log10(OPTIONS["smoothness"].limits[0]) - 1.0
# Names of parameters that are not those of their options. Scenes hold them, so they stay.
_STORED = {
    "model": "genericModel",
    "erosion": "erosionMm",
    "dilation": "dilationMm",
    "tau": "tauMm",
    "smoothness": "smoothnessLog10",
    "tolerance": "toleranceMm",
    "max_iterations": "maxIterations",
    "boundary_weight": "boundaryWeight",
}
# Options that the separation and the fit choose where `...Automatic` is True.
_SEPARATION, _CHOSEN = ("threshold", "erosion", "dilation"), ("net", "tau", "smoothness")
_AUTOMATIC = (*_SEPARATION, *_CHOSEN)


class _Within(WithinRange):
    """Range of an option's parameter; a value outside is refused with the option's own message."""

    def __init__(self, option, low, high, wording="{}"):
        super().__init__(low, high)
        self._option, self._wording = option, wording

    def validate(self, value):
        """Refuse a value outside of the range."""
        if not self.minimum <= value <= self.maximum:
            raise ValueError(self._option.refusal(self._wording.format(value)))


def _ranged(name):
    """Type of the parameter that stores a number of an option."""
    option = OPTIONS[name]
    return Annotated[int if option.whole else float, _Within(option, *option.limits)]


class _Choice(enum.Enum):
    """A choice whose value is the word for it in the library."""

    def label(self):
        """Text in the panel's combo box."""
        return _LABELS[self]()


class _OptionChoice(enum.Enum):
    """A choice of the option that the class is named after; scenes store its name in capital letters."""

    def label(self):
        """Text in the panel's combo box."""
        return translated(OPTIONS[type(self).__name__.lower()].choices[self.value], table)


def _choice(name):
    words = OPTIONS[name.lower()].choices
    return _OptionChoice(name, {word.upper().replace("-", "_"): word for word in words}, module=__name__)


_CHOICES = {name: _choice(name.capitalize()) for name, option in OPTIONS.items() if option.choices}
Model, Closure, Solver, Profile, Levels, Loss, Stopping = (
    _CHOICES[name] for name in ("model", "closure", "solver", "profile", "levels", "loss", "stopping")
)


class RegionSource(_Choice):
    """Where the separated region comes from."""

    THRESHOLDS = "thresholds"
    SEGMENT = "segment"


class ReferenceKind(_Choice):
    """What the surface is compared with."""

    SEGMENT = "segment"
    MODEL = "model"


class OrganState(_Choice):
    """How far an organ has come."""

    NEW = "new"
    SEPARATED = "separated"
    FITTED = "fitted"
    UNSETTLED = "unsettled"
    FAILED = "failed"


# Functions, because Slicer chooses its language after this file is read.
_LABELS = {
    RegionSource.THRESHOLDS: lambda: _("Seeds and grey levels"),
    RegionSource.SEGMENT: lambda: _("Segment of a segmentation"),
    ReferenceKind.SEGMENT: lambda: _("Segment of a segmentation"),
    ReferenceKind.MODEL: lambda: _("Model: another surface or mesh"),
    OrganState.NEW: lambda: _("needs a seed"),
    OrganState.SEPARATED: lambda: _("separated"),
    OrganState.FITTED: lambda: _("fitted"),
    OrganState.UNSETTLED: lambda: _("not settled"),
    OrganState.FAILED: lambda: _("failed"),
}


@parameterNodeWrapper
class OrganParameters:
    """One organ: how it is separated and fitted, the nodes that belong to it, and the result.

    Lengths are in mm. A value with an `...Automatic` beside it is used only if that is False. If it is True, the value
    shows what was chosen: the threshold follows every change of the seeds, the other values every fit.
    """

    label: str = ""
    color: tuple[float, float, float] = (0.8, 0.8, 0.8)

    source: RegionSource = RegionSource.THRESHOLDS
    seeds: Optional[vtkMRMLMarkupsFiducialNode]
    threshold: Annotated[FloatRange, RangeBounds(*OPTIONS["threshold"].limits), Default(FloatRange(0.0, 0.0))]
    thresholdAutomatic: bool = True
    erosionMm: _ranged("erosion") = 2.0
    erosionAutomatic: bool = True
    dilationMm: _ranged("dilation") = 2.0
    dilationAutomatic: bool = True
    inputSegmentation: Optional[vtkMRMLSegmentationNode]
    inputSegmentId: str = ""
    regions: Optional[vtkMRMLSegmentationNode]
    regionSegmentId: str = ""

    genericModel: Model = Model(FitOptions.model)
    netRows: _ranged("net") = 9
    netColumns: _ranged("net") = 7
    netAutomatic: bool = True
    closure: Closure = Closure(FitOptions.closure)
    tauMm: _ranged("tau") = 1.5
    tauAutomatic: bool = True
    profile: Profile = Profile(FitOptions.profile)
    levels: Levels = Levels(FitOptions.levels)
    inside: _ranged("inside") = 1.0
    outside: _ranged("outside") = 0.0
    smoothnessLog10: Annotated[float, _Within(OPTIONS["smoothness"], _NO_SMOOTHNESS, 0.0, "10^{}")] = -5.0
    smoothnessAutomatic: bool = True
    loss: Loss = Loss(FitOptions.loss)
    solver: Solver = Solver(FitOptions.solver)
    stopping: Stopping = Stopping(FitOptions.stopping)
    toleranceMm: _ranged("tolerance") = FitOptions.tolerance
    maxIterations: Annotated[int, _Within(OPTIONS["max_iterations"], 0, OPTIONS["max_iterations"].limits[1])] = 0
    boundaryWeight: _ranged("boundary_weight") = FitOptions.boundary_weight

    surface: Optional[vtkMRMLModelNode]
    boundaryPoints: Optional[vtkMRMLMarkupsFiducialNode]
    convergence: Optional[vtkMRMLTableNode]
    plot: Optional[vtkMRMLPlotChartNode]
    state: OrganState = OrganState.NEW
    message: str = ""
    # One of VICRegistrationLib.registration.verdict.VERDICTS once there is a surface, and why it is not good.
    verdict: str = ""
    verdictReasons: str = ""
    volumeMl: float = 0.0
    # Further stacks of the last fit, the result for each (mrml/stacks.py), and the contours that are shown in them.
    stackVolumes: list[vtkMRMLScalarVolumeNode]
    stackRecords: list[str]
    stackContours: list[vtkMRMLModelNode]

    referenceKind: ReferenceKind = ReferenceKind.SEGMENT
    referenceSegmentation: Optional[vtkMRMLSegmentationNode]
    referenceSegmentId: str = ""
    referenceModel: Optional[vtkMRMLModelNode]

    def options(self):
        """Options for the library's fit.

        Returns
        -------
        VICRegistrationLib.registration.options.FitOptions

        Raises
        ------
        ValueError
            If they contradict each other.
        """
        return FitOptions(**{name: self._optionValue(name) for name in OPTIONS})

    def setFitOptions(self, options):
        """Store the options of a fit; those of the separation stay.

        Parameters
        ----------
        options : VICRegistrationLib.registration.options.FitOptions

        Raises
        ------
        ValueError
            If one of them is out of its range, as values that a fit has chosen may be; nothing is changed then.
        """
        self._take({name: getattr(options, name) for name in OPTIONS if name not in _SEPARATION})

    def _optionValue(self, name):
        """Value of an option as the library takes it; None if it is left to the library."""
        if name in _AUTOMATIC and getattr(self, f"{name}Automatic"):
            return None
        if name == "net":
            return self.netRows, self.netColumns
        if name == "threshold":
            return self.threshold.minimum, self.threshold.maximum
        if name in ("inside", "outside") and self.levels is not Levels.GIVEN:
            return None
        value = getattr(self, _STORED.get(name, name))
        if name == "smoothness":
            least = OPTIONS[name].limits[0]
            return OPTIONS[name].nearest(10.0**value) if value >= math.log10(least) else 0.0
        if name == "max_iterations":
            return value or None
        return value.value if isinstance(value, enum.Enum) else value

    def _take(self, values):
        """Store values of options by their names, all or none; None leaves an option to the library."""
        checked = {name: OPTIONS[name].checked(value) for name, value in values.items()}
        stored = _stored(checked)
        stored.update({f"{name}Automatic": checked[name] is None for name in checked if name in _AUTOMATIC})
        for parameter, value in stored.items():
            setattr(self, parameter, value)

    def showChosen(self, options, net):
        """Store what a fit has chosen as the values of the automatic options.

        Parameters
        ----------
        options : VICRegistrationLib.registration.options.FitOptions
            As used.
        net : (rows, columns)
            The net that was fitted, before boundary points refined it.
        """
        found = {"net": net, "tau": options.tau, "smoothness": options.smoothness}
        shown = {name: OPTIONS[name].nearest(found[name]) for name in self.chosenByFit()}
        for parameter, value in _stored(shown).items():
            setattr(self, parameter, value)

    def chosenByFit(self):
        """Names of the options that a fit chooses by the image.

        Returns
        -------
        list of str
        """
        return [option for option in _CHOSEN if getattr(self, f"{option}Automatic")]

    def setSeparation(self, **values):
        """Store how the organ is separated.

        Parameters
        ----------
        **values
            The options "threshold", "erosion" and "dilation"; None is automatic.

        Raises
        ------
        ValueError
            If one is out of its range; nothing is changed then.
        """
        self._take(values)

    def reference(self):
        """Return the reference that the surface is compared with.

        Returns
        -------
        node : vtkMRMLSegmentationNode or vtkMRMLModelNode or None
        segmentId : str
            Empty for a model.
        """
        if self.referenceKind is ReferenceKind.MODEL:
            return self.referenceModel, ""
        return self.referenceSegmentation, self.referenceSegmentId

    def setReference(self, node, segmentId=""):
        """Store the reference that the surface is compared with.

        Parameters
        ----------
        node : vtkMRMLSegmentationNode or vtkMRMLModelNode
        segmentId : str
        """
        if node.IsA("vtkMRMLModelNode"):
            self.referenceKind, self.referenceModel = ReferenceKind.MODEL, node
        else:
            self.referenceKind = ReferenceKind.SEGMENT
            self.referenceSegmentation, self.referenceSegmentId = node, segmentId

    def contours(self):
        """Models that show the surface in the slices of further stacks.

        Returns
        -------
        list of vtkMRMLModelNode
        """
        return [node for node in self.stackContours if node is not None and node.GetDisplayNode() is not None]


def forgetUnknownChoices(parameterNode):
    """Replace choices that another version has stored, and this one does not know, by the defaults.

    Parameters
    ----------
    parameterNode : vtkMRMLScriptedModuleNode
    """
    for name, kind in OrganParameters.__annotations__.items():
        if isinstance(kind, enum.EnumMeta) and parameterNode.GetParameter(name) not in kind.__members__:
            parameterNode.UnsetParameter(name)


@parameterNodeWrapper
class ModuleParameters:
    """The module: the chosen volume and further stacks, and the organs in the order of the table."""

    volume: Optional[vtkMRMLScalarVolumeNode]
    furtherStacks: list[vtkMRMLScalarVolumeNode]
    organs: list[vtkMRMLScriptedModuleNode]
    current: Optional[vtkMRMLScriptedModuleNode]


def _stored(values):
    """Parameters for values of options by their names; none for values that are None."""
    stored = {}
    for name, value in values.items():
        parameter = _STORED.get(name, name)
        if name == "max_iterations":
            stored[parameter] = value or 0
        elif name == "net" and value is not None:
            stored["netRows"], stored["netColumns"] = value
        elif name == "threshold" and value is not None:
            stored[parameter] = FloatRange(*value)
        elif name == "smoothness" and value is not None:
            stored[parameter] = math.log10(value) if value else _NO_SMOOTHNESS
        elif value is not None:
            stored[parameter] = _CHOICES[name](value) if name in _CHOICES else value
    return stored
