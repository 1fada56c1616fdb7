"""What the module remembers in the scene: one parameter node for the module, one for every organ."""

# Without postponed annotations: Slicer reads these, and does not know `X | None`.
import enum
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

# Grey levels that a threshold may take; the panel narrows its slider to the volume's.
LEVELS = 1e6
# The lower end of the slider stands for none.
NO_SMOOTHNESS = -9.0
# What the other numbers may be; the least smoothness stands for none.
RANGES = {
    "erosionMm": (0.0, 20.0),
    "dilationMm": (0.0, 20.0),
    "netRows": (5, 65),
    "netColumns": (5, 65),
    "tauMm": (0.1, 20.0),
    "smoothnessLog10": (NO_SMOOTHNESS, 0.0),
    "toleranceMm": (0.001, 5.0),
    "maxIterations": (0, 10000),
    "boundaryWeight": (0.0, 10.0),
}


class _Choice(enum.Enum):
    """A choice whose value is the library's word for it."""

    def label(self):
        """Text in the panel's combo box."""
        return _LABELS[self]()


class RegionSource(_Choice):
    """Where the separated region comes from."""

    THRESHOLDS = "thresholds"
    SEGMENT = "segment"


class ReferenceKind(_Choice):
    """What the surface is compared with."""

    SEGMENT = "segment"
    MODEL = "model"


class Closure(_Choice):
    """How the surface is kept closed."""

    SMOOTH = "smooth"
    PAPER = "paper"


class Solver(_Choice):
    """How the cost is minimised."""

    GAUSS_NEWTON = "gauss-newton"
    GRADIENT_DESCENT = "gradient-descent"


class Stopping(_Choice):
    """When a stage of the fit ends."""

    SETTLED = "settled"
    PUBLISHED = "published"


class Profile(_Choice):
    """Where on the ramp of the intensity profile the surface lies."""

    CENTERED = "centered"
    PAPER = "paper"


class Levels(_Choice):
    """How the grey levels inside and outside are found."""

    LOCAL = "local"
    ORGAN = "organ"
    GIVEN = "given"


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
    Closure.SMOOTH: lambda: _("Smooth (tangent plane at the poles)"),
    Closure.PAPER: lambda: _("As published (midpoints)"),
    Solver.GAUSS_NEWTON: lambda: _("Gauss-Newton"),
    Solver.GRADIENT_DESCENT: lambda: _("Gradient descent (as published)"),
    Stopping.SETTLED: lambda: _("At the tolerance, or when settled"),
    Stopping.PUBLISHED: lambda: _("At the tolerance (as published)"),
    Profile.CENTERED: lambda: _("Half-way up the edge"),
    Profile.PAPER: lambda: _("Inner foot of the edge (as published)"),
    Levels.LOCAL: lambda: _("Automatic, along the surface"),
    Levels.ORGAN: lambda: _("Automatic, one for the organ"),
    Levels.GIVEN: lambda: _("Given"),
    OrganState.NEW: lambda: _("needs a seed"),
    OrganState.SEPARATED: lambda: _("separated"),
    OrganState.FITTED: lambda: _("fitted"),
    OrganState.UNSETTLED: lambda: _("not settled"),
    OrganState.FAILED: lambda: _("failed"),
}


# What a fit chooses where `...Automatic` says so, by the library's names.
_CHOSEN = ("net", "tau", "smoothness")

_WORDS = {
    "erosionMm": lambda: _("the erosion in mm"),
    "dilationMm": lambda: _("the dilation in mm"),
    "netRows": lambda: _("the rows of the control net"),
    "netColumns": lambda: _("the columns of the control net"),
    "tauMm": lambda: _("the width of the edge (tau) in mm"),
    "toleranceMm": lambda: _("the tolerance in mm"),
    "maxIterations": lambda: _("the number of iterations"),
    "boundaryWeight": lambda: _("the weight of the boundary points"),
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
    threshold: Annotated[FloatRange, RangeBounds(-LEVELS, LEVELS), Default(FloatRange(0.0, 0.0))]
    thresholdAutomatic: bool = True
    erosionMm: Annotated[float, WithinRange(*RANGES["erosionMm"])] = 2.0
    erosionAutomatic: bool = True
    dilationMm: Annotated[float, WithinRange(*RANGES["dilationMm"])] = 2.0
    dilationAutomatic: bool = True
    inputSegmentation: Optional[vtkMRMLSegmentationNode]
    inputSegmentId: str = ""
    regions: Optional[vtkMRMLSegmentationNode]
    regionSegmentId: str = ""

    netRows: Annotated[int, WithinRange(*RANGES["netRows"])] = 9
    netColumns: Annotated[int, WithinRange(*RANGES["netColumns"])] = 7
    netAutomatic: bool = True
    closure: Closure = Closure.SMOOTH
    tauMm: Annotated[float, WithinRange(*RANGES["tauMm"])] = 1.5
    tauAutomatic: bool = True
    profile: Profile = Profile.CENTERED
    levels: Levels = Levels.LOCAL
    inside: Annotated[float, WithinRange(-LEVELS, LEVELS)] = 1.0
    outside: Annotated[float, WithinRange(-LEVELS, LEVELS)] = 0.0
    smoothnessLog10: Annotated[float, WithinRange(*RANGES["smoothnessLog10"])] = -5.0
    smoothnessAutomatic: bool = True
    solver: Solver = Solver.GAUSS_NEWTON
    stopping: Stopping = Stopping.SETTLED
    toleranceMm: Annotated[float, WithinRange(*RANGES["toleranceMm"])] = 0.1
    maxIterations: Annotated[int, WithinRange(*RANGES["maxIterations"])] = 0
    boundaryWeight: Annotated[float, WithinRange(*RANGES["boundaryWeight"])] = 1.0

    surface: Optional[vtkMRMLModelNode]
    boundaryPoints: Optional[vtkMRMLMarkupsFiducialNode]
    convergence: Optional[vtkMRMLTableNode]
    plot: Optional[vtkMRMLPlotChartNode]
    state: OrganState = OrganState.NEW
    message: str = ""
    volumeMl: float = 0.0

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
        from ..registration.options import FitOptions

        given = self.levels is Levels.GIVEN
        return FitOptions(
            net=None if self.netAutomatic else (self.netRows, self.netColumns),
            closure=self.closure.value,
            threshold=None if self.thresholdAutomatic else (self.threshold.minimum, self.threshold.maximum),
            erosion=None if self.erosionAutomatic else self.erosionMm,
            dilation=None if self.dilationAutomatic else self.dilationMm,
            solver=self.solver.value,
            tau=None if self.tauAutomatic else self.tauMm,
            centered=self.profile is Profile.CENTERED,
            levels=self.levels.value,
            inside=self.inside if given else None,
            outside=self.outside if given else None,
            smoothness=None if self.smoothnessAutomatic else _smoothness(self.smoothnessLog10),
            stopping=self.stopping.value,
            tolerance=self.toleranceMm,
            max_iterations=self.maxIterations or None,
            boundary_weight=self.boundaryWeight,
        )

    def setFitOptions(self, options):
        """Take over how a surface is fitted; how the organ is separated stays.

        Parameters
        ----------
        options : VICRegistrationLib.registration.options.FitOptions

        Raises
        ------
        ValueError
            If one of them is out of the range that the module offers; nothing is changed then.
        """
        rows, columns = options.net or (None, None)
        given = {
            "netRows": rows,
            "netColumns": columns,
            "tauMm": options.tau,
            "toleranceMm": options.tolerance,
            "maxIterations": options.max_iterations or 0,
            "boundaryWeight": options.boundary_weight,
        }
        given = {name: _checked(name, value) for name, value in given.items() if value is not None}
        if options.smoothness is not None:
            given["smoothnessLog10"] = _smoothnessLog10(options.smoothness)
        self.closure = Closure(options.closure)
        self.solver = Solver(options.solver)
        self.stopping = Stopping(options.stopping)
        for name in _CHOSEN:
            setattr(self, f"{name}Automatic", getattr(options, name) is None)
        self.profile = Profile.CENTERED if options.centered else Profile.PAPER
        self.levels = Levels(options.levels)
        if options.inside is not None and options.outside is not None:
            self.inside, self.outside = float(options.inside), float(options.outside)
        for name, value in given.items():
            setattr(self, name, value)

    def showChosen(self, options, net):
        """Show what a fit has chosen, in the place of the values that it left alone.

        Parameters
        ----------
        options : VICRegistrationLib.registration.options.FitOptions
            As used.
        net : (rows, columns)
            That was fitted, before boundary points made it finer.
        """
        shown = {
            "net": {"netRows": net[0], "netColumns": net[1]},
            "tau": {"tauMm": options.tau},
            "smoothness": {"smoothnessLog10": _smoothnessLog10(options.smoothness)},
        }
        for option in self.chosenByFit():
            for name, value in shown[option].items():
                setattr(self, name, _nearest(name, value))

    def chosenByFit(self):
        """Names of the options that a fit chooses by what the image shows.

        Returns
        -------
        list of str
        """
        return [option for option in _CHOSEN if getattr(self, f"{option}Automatic")]

    def setRadii(self, erosion, dilation):
        """Give erosion and dilation, or leave them to the separation.

        Parameters
        ----------
        erosion, dilation : float or None
            mm.

        Raises
        ------
        ValueError
            If one is out of the range that the module offers; nothing is changed then.
        """
        given = {"erosion": erosion, "dilation": dilation}
        checked = {name: _checked(f"{name}Mm", value) for name, value in given.items() if value is not None}
        for name in given:
            setattr(self, f"{name}Automatic", name not in checked)
        for name, value in checked.items():
            setattr(self, f"{name}Mm", value)

    def reference(self):
        """Tell what the surface is to be compared with.

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

    def ownedNodes(self):
        """Nodes that go with the organ; the segmentation is shared by all organs.

        Returns
        -------
        list of vtkMRMLNode
        """
        found = [self.seeds, self.boundaryPoints, self.surface, self.convergence, self.plot]
        return [node for node in found if node is not None]


@parameterNodeWrapper
class ModuleParameters:
    """The module: the volume and its organs, in the order of the panel's table."""

    volume: Optional[vtkMRMLScalarVolumeNode]
    organs: list[vtkMRMLScriptedModuleNode]
    current: Optional[vtkMRMLScriptedModuleNode]


def _smoothness(power):
    """Return the weight of the bending energy that a power of ten stands for."""
    return 10.0**power if power > NO_SMOOTHNESS else 0.0


def _smoothnessLog10(smoothness):
    """Return the power of ten that the slider shows for a weight."""
    import math

    return _nearest("smoothnessLog10", math.log10(smoothness) if smoothness else NO_SMOOTHNESS)


def _nearest(name, value):
    """Return the value of a parameter's range that is nearest to a number."""
    low, high = RANGES[name]
    return type(low)(min(max(value, low), high))


def _checked(name, value):
    """Return a number as its parameter holds it, after looking that it is in the range."""
    low, high = RANGES[name]
    try:
        number = type(low)(value)
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or not low <= number <= high:
        raise ValueError(
            _("The value {value} was given for {name}; one from {low} to {high} is needed. Choose another.").format(
                value=value, name=_WORDS[name](), low=low, high=high
            )
        )
    return number
