"""Fitting a generic model to the organs of the table, step by step."""

from __future__ import annotations

from dataclasses import replace

from slicer.i18n import tr as _

from .fitting import checkedSteps, checkInScene
from .generic_model import GenericModelParameters, modelNamed, pairedOrgans, placedLandmarks
from .generic_model_nodes import showModel
from .organ_nodes import setRegionVisible
from .organs import Organs
from .parameters import ModuleParameters
from .points import placedPoints
from .sentences import sentence
from .separating import separateOrgan
from .stacks import leftOutSentences, stacksToFit
from .volumes import imageFromVolume


def fitModel(parameters, volumeNode, model="pelvis", landmarks=None, *, onStep=None):
    """Fit a generic model to organs of the scene, and show it in a folder of its own.

    Parameters
    ----------
    parameters : ModuleParameters
        Of the module's logic; organs with the names of the model's organs are fitted, others are predicted.
    volumeNode : vtkMRMLScalarVolumeNode
    model : str
        A model that ships, or the path of a file.
    landmarks : vtkMRMLMarkupsFiducialNode, optional
        Places on bone, labelled as in the model.
    onStep : callable, optional
        Called with a description, str, at every step.

    Returns
    -------
    VICRegistrationLib.multipatch.fit.ModelFit
        Local RAS mm: that of the volume before its parent transform.

    Raises
    ------
    ValueError
        If the model cannot be fitted; an earlier result stays.
    """
    from ..registration.steps import finish

    chosen = GenericModelParameters(parameters.parameterNode)
    chosen.modelName, chosen.modelLandmarks = model, landmarks
    return finish(modelSteps(chosen, Organs(parameters), volumeNode), onStep)


def modelSteps(parameters, organs, volumeNode):
    """Separate organs, fit a generic model to them, and show it in place of an earlier one.

    Parameters
    ----------
    parameters : GenericModelParameters
    organs : iterable of OrganParameters
        All organs of the table. Those that are paired with organs of the model are fitted with their own options,
        and to the further stacks that are chosen in the panel.
    volumeNode : vtkMRMLScalarVolumeNode

    Yields
    ------
    str
        What is being done, for the panel. Closing the generator leaves an earlier result as it was.

    Returns
    -------
    VICRegistrationLib.multipatch.fit.ModelFit
        In the volume's local RAS mm.

    Raises
    ------
    ValueError
        If an organ cannot be separated, the model cannot be fitted, or a node that is needed was deleted meanwhile.
    """
    from ..multipatch.fit import check_organs, fit_model
    from ..multipatch.landmarks import check_names

    image, model = imageFromVolume(volumeNode), modelNamed(parameters.modelName)
    pairs = pairedOrgans(model, organs)
    options = {name: _optionsOf(organ) for name, organ in pairs.items()}
    check_organs(model, options)
    landmarks = placedLandmarks(parameters.modelLandmarks, volumeNode)
    check_names(model, landmarks)
    chosen = [node for node in ModuleParameters(parameters.parameterNode).furtherStacks if node is not volumeNode]
    stacks, leftOut = stacksToFit(volumeNode, [node for node in chosen if node is not None])
    needed = _neededFor(pairs, volumeNode, stacks)
    regions, warnings = {}, _notUsed(pairs, leftOut)
    for name, organ in pairs.items():
        yield _("{organ}: separating").format(organ=organ.label)
        checkInScene(needed)
        regions[name], found = separateOrgan(organ, volumeNode)
        warnings += [f"{organ.label}: {warning}" for warning in found]
    steps = fit_model(image, model, regions, options, landmarks=landmarks, further=tuple(stacks.values()))
    fit = yield from checkedSteps(steps, lambda: checkInScene(needed), _shown)
    warnings += yield from _examined(image, fit, pairs, needed)
    for organ in pairs.values():
        # The filled region would cover the parts in the slice views.
        setRegionVisible(organ, False)
    showModel(volumeNode, fit.model, "\n".join([*_summary(fit, pairs), *dict.fromkeys(warnings)]))
    return fit


def _examined(image, fit, pairs, needed):
    """Compute the diagnostics of a fit one after the other; all at once would block the panel for seconds."""
    from ..registration.diagnostics import fit_diagnostics

    # The fit caches these values.
    examinations = {
        _("Distances from the regions"): lambda: fit.deviations,
        _("Determinant of the map"): lambda: fit.smallest_determinant,
        _("Sliding of attachments"): lambda: fit.sliding,
        _("Intersections of parts"): lambda: fit.diagnostics,
    }
    for words, examine in examinations.items():
        yield words
        checkInScene(needed)
        examine()
    found = [sentence(diagnostic) for diagnostic in fit.diagnostics]
    for name, organ in pairs.items():
        yield _("{organ}: checking the surface").format(organ=organ.label)
        checkInScene(needed)
        found += [f"{organ.label}: {sentence(each)}" for each in fit_diagnostics(image, fit.organs[name])]
    yield _("Showing the model")
    checkInScene(needed)
    return found


def _shown(step):
    """Text for a step of the library's fit."""
    return _("{stage}, iteration {iteration}, cost {cost}").format(
        stage=step.stage, iteration=step.iteration, cost=f"{step.cost:.3g}"
    )


def _neededFor(pairs, volumeNode, stackNodes):
    """Nodes that a fit needs, what each is called, and what to do if it was deleted."""
    nodes = [(volumeNode, _("volume {name}").format(name=volumeNode.GetName()))]
    nodes += [(organ.parameterNode, _("organ {name}").format(name=organ.label)) for organ in pairs.values()]
    nodes += [(node, _("stack {name}").format(name=node.GetName())) for node in stackNodes]
    return [(*entry, _("Fit the model again.")) for entry in nodes]


def _notUsed(pairs, leftOut):
    """Warnings about boundary points and stacks that the fit of a model does not use."""
    found = [
        _("{organ}: the fit of a model does not use its boundary points.").format(organ=organ.label)
        for organ in pairs.values()
        if len(placedPoints(organ.boundaryPoints))
    ]
    return found + leftOutSentences(leftOut)


def _optionsOf(organ):
    """Options of an organ, except those of its generic shape: that is the model's."""
    from ..registration.options import FitOptions

    return replace(organ.options(), net=None, closure=FitOptions.closure, model=FitOptions.model)


def _summary(fit, pairs):
    """Lines with the figures of a fit."""
    determinant, part = fit.smallest_determinant
    lines = [
        _("Model fitted to {organs} in {seconds} s").format(organs=", ".join(pairs), seconds=f"{fit.seconds:.1f}"),
        _("Smallest determinant of the map: {determinant}, near {part}").format(
            determinant=f"{determinant:.2f}", part=part
        ),
        _("Mean distance from the regions: {distances}").format(
            distances=", ".join(f"{name} {distance:.2f} mm" for name, distance in fit.deviations.items())
        ),
    ]
    if fit.sliding:
        part, distance = max(fit.sliding.items(), key=lambda item: item[1])
        lines.append(_("Attachments slid by up to {distance} mm: {part}").format(distance=f"{distance:.2f}", part=part))
    moved = [_motion(name, stack) for name in pairs for stack in fit.organs[name].stacks if stack.used]
    if moved:
        lines.append(_("Motion in further stacks: {motions}").format(motions="; ".join(moved)))
    if fit.landmarks:
        lines.append(_("Landmarks are met within {distance} mm").format(distance=f"{max(fit.landmarks.values()):.1f}"))
    return lines


def _motion(name, stack):
    """Text for the motion of an organ in a further stack."""
    return _("{organ} {shift} mm, {turn} degrees in {stack}").format(
        organ=name,
        shift=f"{(stack.translation_mm @ stack.translation_mm) ** 0.5:.1f}",
        turn=f"{stack.rotation_degrees:.1f}",
        stack=stack.name,
    )
