"""What the module remembers in the scene: one parameter node for the module, one for every organ."""

# Without postponed annotations: Slicer reads these, and does not know `X | None`.
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

# A weight of the bending energy is stored as its power of ten; from this one down it is none.
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
# What the separation and the fit choose where `...Automatic` says so.
_SEPARATION, _CHOSEN = ("threshold", "erosion", "dilation"), ("net", "tau", "smoothness")
_AUTOMATIC = (*_SEPARATION, *_CHOSEN)


class _Within(WithinRange):
    """Range of an option's parameter; what is outside is refused by the option's sentence."""

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
    """A choice whose value is the library's word for it."""

    def label(self):
        """Text in the panel's combo box."""
        return _LABELS[self]()


class _OptionChoice(enum.Enum):
    """One of the words of the option that is named like the class; scenes hold the name in capital letters."""

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


# Texts are made when they are shown: Slicer chooses its language after this file is read.
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
    """One organ: how it is to be separated and fitted, the nodes that belong to it, and what came out.

    Lengths are in mm. A value with an `...Automatic` beside it counts only where that is False. Where it is True, the
    value shows what was used: a threshold is replaced by the suggestion at every change, the others by every fit.
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
    # Further stacks of the last fit, what became of each (mrml/stacks.py), and the contours that are shown in them.
    stackVolumes: list[vtkMRMLScalarVolumeNode]
    stackRecords: list[str]
    stackContours: list[vtkMRMLModelNode]

    referenceKind: ReferenceKind = ReferenceKind.SEGMENT
    referenceSegmentation: Optional[vtkMRMLSegmentationNode]
    referenceSegmentId: str = ""
    referenceModel: Optional[vtkMRMLModelNode]

    def options(self):
        """Choices for the library's fit.

        Returns
        -------
        VICRegistrationLib.registration.options.FitOptions

        Raises
        ------
        ValueError
            If they do not go together.
        """
        return FitOptions(**{name: self._optionValue(name) for name in OPTIONS})

    def setFitOptions(self, options):
        """Take over how a surface is fitted; how the organ is separated stays.

        Parameters
        ----------
        options : VICRegistrationLib.registration.options.FitOptions

        Raises
        ------
        ValueError
            If one of them is out of its range, as what a fit has found may be; nothing is changed then.
        """
        self._take({name: getattr(options, name) for name in OPTIONS if name not in _SEPARATION})

    def _optionValue(self, name):
        """Value of an option as the library takes it; None where it is left to the library."""
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
        """Take over values of options by their names, all or none; None leaves an option to the library."""
        checked = {name: OPTIONS[name].checked(value) for name, value in values.items()}
        stored = _stored(checked)
        stored.update({f"{name}Automatic": checked[name] is None for name in checked if name in _AUTOMATIC})
        for parameter, value in stored.items():
            setattr(self, parameter, value)

    def showChosen(self, options, net):
        """Show what a fit has chosen, in the place of the values that it left alone.

        Parameters
        ----------
        options : VICRegistrationLib.registration.options.FitOptions
            As used.
        net : (rows, columns)
            That was fitted, before boundary points made it finer.
        """
        found = {"net": net, "tau": options.tau, "smoothness": options.smoothness}
        shown = {name: OPTIONS[name].nearest(found[name]) for name in self.chosenByFit()}
        for parameter, value in _stored(shown).items():
            setattr(self, parameter, value)

    def chosenByFit(self):
        """Names of the options that a fit chooses by what the image shows.

        Returns
        -------
        list of str
        """
        return [option for option in _CHOSEN if getattr(self, f"{option}Automatic")]

    def setSeparation(self, **values):
        """Give what the organ is separated by, or leave it to the separation.

        Parameters
        ----------
        **values
            Options of the library by the names "threshold", "erosion" and "dilation"; None is automatic.

        Raises
        ------
        ValueError
            If one is out of its range; nothing is changed then.
        """
        self._take(values)

    def reference(self):
        """Return what the surface is to be compared with.

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
        """Remember what the surface is compared with.

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
    """Let an organ of another version have the defaults in place of choices that this one does not know.

    Parameters
    ----------
    parameterNode : vtkMRMLScriptedModuleNode
    """
    for name, kind in OrganParameters.__annotations__.items():
        if isinstance(kind, enum.EnumMeta) and parameterNode.GetParameter(name) not in kind.__members__:
            parameterNode.UnsetParameter(name)


@parameterNodeWrapper
class ModuleParameters:
    """The module: the volume with the further stacks that are chosen, and its organs, in the order of the table."""

    volume: Optional[vtkMRMLScalarVolumeNode]
    furtherStacks: list[vtkMRMLScalarVolumeNode]
    organs: list[vtkMRMLScriptedModuleNode]
    current: Optional[vtkMRMLScriptedModuleNode]


def _stored(values):
    """Parameters that stand for values of options by their names; those that are None have none."""
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
