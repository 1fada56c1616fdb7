"""Fitting an organ of the scene, and fitting it again through boundary points, step by step."""

from __future__ import annotations

import slicer
from slicer.i18n import tr as _

from .colors import colorBy, coloredBy, exchangePolyData, hasScalars
from .convergence import showConvergence
from .organ_nodes import convergenceOf, followVolume, modelOf, removeNodes, setRegionVisible, volumeOf
from .parameters import OrganState
from .points import labelPoints
from .sentences import sentence
from .separating import imageAndRegion
from .stack_contours import showStackContours
from .stacks import keepStacks, leftOutSentences, stacksOf, stacksToFit, wallPoints
from .surfaces import showSurface, surfaceIfAny, surfaceOf, worldVolumeMl
from .volumes import imageFromVolume, putUnderVolume


def fitSteps(organ, volumeNode, furtherStacks=()):
    """Fit an organ from its region, step by step.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode
    furtherStacks : sequence of vtkMRMLScalarVolumeNode
        Other volumes of the patient, which the surface is fitted to as well.

    Yields
    ------
    VICRegistrationLib.registration.stages.Step
        In the volume's local RAS mm. Closing the generator leaves the surface as it was before.

    Returns
    -------
    VICRegistrationLib.registration.organ_fit.OrganFit

    Raises
    ------
    ValueError
        If the organ cannot be separated or fitted, or a node that is needed was deleted meanwhile.
    """
    from ..registration.organ import fit_region

    with _FitOnNodes(organ, volumeNode, furtherStacks) as run:
        image, region = imageAndRegion(organ, volumeNode)
        given = {"boundary_points": _boundaryPoints(organ, volumeNode), "further": run.stacks()}
        return (yield from run.followed(image, fit_region(image, region, organ.options(), **given)))


def refitSteps(organ, volumeNode):
    """Fit an organ again from the surface it has, through its boundary points, step by step.

    Parameters
    ----------
    organ : OrganParameters
        With the further stacks of its last fit.
    volumeNode : vtkMRMLScalarVolumeNode

    Yields
    ------
    VICRegistrationLib.registration.stages.Step

    Returns
    -------
    VICRegistrationLib.registration.organ_fit.OrganFit

    Raises
    ------
    ValueError
        If the organ has no surface yet, or as :func:`fitSteps`.
    """
    from ..registration.refit import refit

    with _FitOnNodes(organ, volumeNode, stacksOf(organ)) as run:
        image = imageFromVolume(volumeNode)
        followVolume(organ, volumeNode)
        surface = surfaceOf(organ, corrected=False)
        # From the surface before earlier points corrected it: a point that was removed then has no effect.
        further = run.stacks(stacksOf(organ))
        given = {"boundary_points": _boundaryPoints(organ, volumeNode), "further": further}
        return (yield from run.followed(image, refit(image, surface, organ.options(), **given)))


def boundaryDeviations(organ, volumeNode):
    """Distances of the boundary points from the surface, also written beside the points in the views.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    (n,) ndarray
        Signed, mm of the volume's local frame; positive where the point lies outside. Empty without a surface or a
        volume.

    Raises
    ------
    ValueError
        If the model of the organ does not carry a surface.
    """
    import numpy as np

    from ..registration.boundary_points import boundary_deviations

    if organ.surface is None or volumeNode is None:
        return np.empty(0)
    points = wallPoints(organ, volumeNode)
    if not len(points):
        return np.empty(0)
    deviations = boundary_deviations(surfaceOf(organ), points)
    labelPoints(organ.boundaryPoints, [f"{deviation:+.2f} mm" for deviation in deviations])
    return deviations


def updateVolume(organ):
    """Compute the volume of an organ's surface again, after the transform that it is under has changed.

    Parameters
    ----------
    organ : OrganParameters
        Nothing is done if it has no surface, or if another module has changed the triangles.
    """
    fitted = organ.surface is not None and organ.state in (OrganState.FITTED, OrganState.UNSETTLED)
    surface = surfaceIfAny(organ.surface) if fitted else None
    if surface is not None:
        organ.volumeMl = float(worldVolumeMl(organ.surface, surface))


def checkedSteps(steps, check, shown=lambda step: step):
    """Pass on the steps of a fit as long as the nodes that it needs are in the scene.

    Parameters
    ----------
    steps : generator
    check : callable
        Called without arguments before every step; raises an error if a node is missing.
    shown : callable, optional
        Turns a step into what is passed on.

    Yields
    ------
    object
        What `shown` returns.

    Returns
    -------
    object
        What `steps` returns.
    """
    while True:
        check()
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value
        yield shown(step)


def checkInScene(needed):
    """Raise an error if a node that a fit needs was deleted.

    Parameters
    ----------
    needed : sequence of (vtkMRMLNode, str, str)
        Nodes, what each is called, and what to do if it was deleted.

    Raises
    ------
    ValueError
        If one is not in the scene.
    """
    for node, what, remedy in needed:
        if not _isThere(node):
            raise ValueError(
                _("The {what} was deleted, but it is needed for the fit. {remedy}").format(what=what, remedy=remedy)
            )


class _FitOnNodes:
    """Shows a fit in the nodes of an organ, and restores them if the fit fails or is cancelled."""

    def __init__(self, organ, volumeNode, furtherStacks):
        self.organ, self.volumeNode = organ, volumeNode
        self._further = [node for node in furtherStacks if node is not volumeNode]
        self._needed = [(organ.parameterNode, _("organ"), _("Add the organ again."))]
        for node in self._further:
            self._needed.append((node, _("stack {name}").format(name=node.GetName()), _("Fit again without it.")))
        self._fitted, self._leftOut = (), {}
        self.before = organ.surface.GetPolyData() if organ.surface is not None else None
        self.volumeBefore = volumeOf(organ)
        self.colored = coloredBy(organ.surface)
        self.model = None

    def __enter__(self):
        checkInScene(self._needed)
        return self

    def __exit__(self, kind, error, trace):
        if kind is None:
            return
        # Not organ.surface: an organ that was removed from the scene has lost that reference.
        if _isThere(self.model) and self.before is not None:
            exchangePolyData(self.model, self.before)
            if _isThere(self.volumeBefore):
                putUnderVolume(self.model, self.volumeBefore)
            self._colorAgain()
        elif _isThere(self.model):
            removeNodes([self.model])
        if isinstance(error, ValueError) and _isThere(self.organ.parameterNode):
            self.organ.message = str(error)
            if self.organ.surface is None:
                self.organ.state = OrganState.FAILED

    def stacks(self, records=None):
        """Further stacks for the library; the search for their motions begins at those of an earlier fit."""
        stacks, self._leftOut = stacksToFit(self.volumeNode, self._further, records)
        self._fitted = tuple(stacks)
        return tuple(stacks.values())

    def followed(self, image, steps):
        """Pass on the steps of a fit as long as the nodes that it needs are in the scene, and store its result."""
        self.model = modelOf(self.organ, self.volumeNode)
        volume = _("volume {name}").format(name=self.volumeNode.GetName())
        self._needed.append((self.volumeNode, volume, _("Choose a volume and fit again.")))
        self._needed.append((self.model, _("surface"), _("Fit the organ again.")))
        fit = yield from checkedSteps(steps, lambda: checkInScene(self._needed))
        self._record(image, fit)
        return fit

    def _record(self, image, fit):
        from ..registration.diagnostics import fit_diagnostics
        from ..registration.nets import net_of
        from ..registration.verdict import verdict_of

        organ, model = self.organ, self.model
        uncorrected = fit.uncorrected if len(fit.boundary_points) else None
        showSurface(
            model,
            fit.surface,
            name=organ.label,
            uncorrected=uncorrected,
            standardDeviation=fit.confidence.standard_deviation,
        )
        self._colorAgain()
        keepStacks(organ, self.volumeNode, self._fitted, fit.stacks, self._leftOut)
        showStackContours(organ, self.volumeNode)
        showConvergence(convergenceOf(organ, self.volumeNode), fit.history)
        boundaryDeviations(organ, self.volumeNode)
        setRegionVisible(organ, False)
        with slicer.util.NodeModify(organ.parameterNode):
            organ.state = OrganState.FITTED if fit.converged else OrganState.UNSETTLED
            organ.volumeMl = float(worldVolumeMl(model, fit.surface))
            organ.showChosen(fit.options, net_of(fit.uncorrected, fit.options.closure))
            # A transform that stretches the organ stretches its error bar.
            error = fit.confidence.volume_sd_ml * organ.volumeMl / (fit.surface.volume() / 1000.0)
            deviation = f" ± {error:.1f}" if error >= 0.1 else f" ± {error:.2f}"
            result = _("{volume} ml; {count} iterations, cost {cost}, {seconds} s").format(
                volume=f"{organ.volumeMl:.1f}{deviation if fit.confidence.volume_calibrated else ''}",
                count=fit.iterations,
                cost=f"{fit.cost_final:.3g}",
                seconds=f"{fit.seconds:.2f}",
            )
            diagnostics, left = fit_diagnostics(image, fit), leftOutSentences(self._leftOut)
            organ.message = "\n".join([result, *self._chosen(fit), *map(sentence, diagnostics), *left])
            verdict = verdict_of(fit, diagnostics)
            organ.verdict, organ.verdictReasons = verdict.word, "\n".join(map(sentence, verdict.reasons))

    def _chosen(self, fit):
        """One line with the options that the fit has chosen; no line if all were given."""
        words = {"net": _("net {value}"), "tau": _("edge {value}"), "smoothness": _("smoothness {value}")}
        automatic = self.organ.chosenByFit()
        listed = [choice for choice in fit.choices if choice.option in automatic]
        chosen = [words[choice.option].format(value=choice.value) for choice in listed]
        return [_("Chosen: {choices}").format(choices=", ".join(chosen))] if chosen else []

    def _colorAgain(self):
        """Colour the model by the same scalars as before the fit, if it has them; while it moves it has none."""
        if hasScalars(self.model, self.colored):
            colorBy(self.model, self.colored)


def _isThere(node):
    return node is not None and node.GetScene() is not None


def _boundaryPoints(organ, volumeNode):
    points = wallPoints(organ, volumeNode)
    return points if len(points) else None
