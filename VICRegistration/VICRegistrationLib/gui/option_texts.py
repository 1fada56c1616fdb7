"""The widgets of the options of a fit, with their texts from the table of options. Needs no Slicer."""

from __future__ import annotations

from ..registration.options import AUTOMATIC, IN_POWERS_OF_TEN, OPTIONS, WITH_DEFAULT, FitOptions

# Option, parameter of an organ, widget. A label has the name of the widget, such as "netLabel".
WIDGETS = (
    ("model", "genericModel", "modelCombo"),
    ("net", "netRows", "netRowsSpin"),
    ("net", "netColumns", "netColumnsSpin"),
    ("net", "netAutomatic", "netAutomaticCheck"),
    ("closure", "closure", "closureCombo"),
    ("tau", "tauMm", "tauSlider"),
    ("tau", "tauAutomatic", "tauAutomaticCheck"),
    ("profile", "profile", "profileCombo"),
    ("levels", "levels", "levelsCombo"),
    ("inside", "inside", "insideSpin"),
    ("outside", "outside", "outsideSpin"),
    ("smoothness", "smoothnessLog10", "smoothnessSlider"),
    ("smoothness", "smoothnessAutomatic", "smoothnessAutomaticCheck"),
    ("loss", "loss", "lossCombo"),
    ("solver", "solver", "solverCombo"),
    ("stopping", "stopping", "stoppingCombo"),
    ("tolerance", "toleranceMm", "toleranceSpin"),
    ("max_iterations", "maxIterations", "maxIterationsSpin"),
)
# Widgets in other sections.
ELSEWHERE = (
    ("threshold", "threshold", "thresholdRange"),
    ("erosion", "erosionMm", "erosionSlider"),
    ("erosion", "erosionAutomatic", "erosionAutomaticCheck"),
    ("dilation", "dilationMm", "dilationSlider"),
    ("dilation", "dilationAutomatic", "dilationAutomaticCheck"),
    ("boundary_weight", "boundaryWeight", "boundaryWeightSlider"),
)


def optionTexts(translate=str):
    """Make the texts of the options' widgets.

    Parameters
    ----------
    translate : callable
        Takes an English text of the table of options.

    Returns
    -------
    labels, toolTips : dict of str to str
        By the names of the widgets.
    """
    labels, toolTips = {}, {}
    for name, parameter, widget in (*WIDGETS, *ELSEWHERE):
        option, default = OPTIONS[name], getattr(FitOptions, name)
        texts = option.label, option.help, option.automatic or option.choices.get(default, f"{default}")
        label, does, usual = map(translate, texts)
        template = AUTOMATIC if parameter.endswith("Automatic") else WITH_DEFAULT
        toolTips[widget] = translate(template).format(help=does, default=usual)
        first, *others = name.split("_")
        labels[first + "".join(map(str.capitalize, others)) + "Label"] = f"{label[0].upper()}{label[1:]}:"
    toolTips["smoothnessSlider"] += " " + translate(IN_POWERS_OF_TEN)
    # They share a label of their own.
    del labels["insideLabel"], labels["outsideLabel"]
    return labels, toolTips
