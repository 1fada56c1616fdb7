"""Colours of surfaces: range, legend, and when they go and come back."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_references import (
    DEVIATION,
    STANDARD_DEVIATION,
    add_organ,
    colors_of,
    larger,
    legend_of,
    rows,
    surface_model,
)
from mrml_scenes import slicer
from small_phantom import CENTER, ellipsoid
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.geometry.triangulation import triangulate

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "few_points")


def test_the_surface_is_coloured_with_one_range_on_both_sides_and_a_legend(logic, organ):
    logic.compare(organ, surface_model(larger(0.0, shift=(3.0, 0.0, 0.0))))
    display, legend = organ.surface.GetDisplayNode(), legend_of(organ)
    assert display.GetScalarVisibility()
    assert display.GetActiveScalarName() == DEVIATION
    assert display.GetScalarRangeFlag() == slicer.vtkMRMLDisplayNode.UseManualScalarRange
    # Shifted by 3 mm, 95 % of the surface is within 3 mm: rounded up to 5.
    assert display.GetScalarRange() == (-5.0, 5.0)
    assert display.GetColorNode().GetName() == "DivergingBlueRed"
    assert legend.GetVisibility()
    assert legend.GetTitleText() == DEVIATION
    # In slice views it would lie on the image.
    assert not legend.GetVisibility2D()
    values = colors_of(organ)
    points = slicer.util.arrayFromModelPoints(organ.surface)
    right, left = values[points[:, 0].argmax()], values[points[:, 0].argmin()]
    # The surface lies inside of the reference on the right, and outside of it on the left.
    assert (right, left) == (pytest.approx(-3.0, abs=0.05), pytest.approx(3.0, abs=0.05))


def test_the_organs_colour_comes_back_and_goes(logic, organ):
    logic.compare(organ, surface_model(larger(1.0)))
    display = organ.surface.GetDisplayNode()
    logic.color(organ)
    assert not display.GetScalarVisibility()
    assert not legend_of(organ).GetVisibility()
    assert display.GetColor() == pytest.approx(organ.color)
    logic.color(organ, DEVIATION)
    assert display.GetScalarVisibility()
    assert legend_of(organ).GetVisibility()
    with pytest.raises(ValueError, match=r"no point scalars named Standard deviation \(mm\)"):
        logic.color(organ, STANDARD_DEVIATION)
    assert display.GetActiveScalarName() == DEVIATION


def test_organs_in_the_same_colours_have_one_range_and_one_legend(logic, organ):
    from VICRegistrationLib.mrml.organ_nodes import setVisible

    second = add_organ(logic, "second", logic.getParameterNode().volume, larger(1.0))
    for one, millimetres in ((organ, 0.7), (second, 2.9)):
        logic.compare(one, surface_model(larger(millimetres)))

    def range_of(one):
        return one.surface.GetDisplayNode().GetScalarRange()

    def shown():
        legends = slicer.util.getNodesByClass("vtkMRMLColorLegendDisplayNode")
        return [legend.GetDisplayableNode() for legend in legends if legend.GetVisibility()]

    assert range_of(organ) == range_of(second) == (-2.0, 2.0)
    assert shown() == [organ.surface]
    # It is one of an organ that is seen.
    setVisible(organ, False)
    assert shown() == [second.surface]
    setVisible(organ, True)
    logic.organs().remove(second)
    assert shown() == [organ.surface]
    assert range_of(organ) == (-1.0, 1.0)
    setVisible(organ, False)
    assert shown() == []


def test_a_surface_that_changes_gets_its_own_colour_back(logic, organ):
    from VICRegistrationLib.mrml.comparing import comparisonText

    logic.compare(organ, surface_model(larger(1.0)))
    assert "Hausdorff" in comparisonText(organ)
    logic.setSurface(organ, larger(0.5))
    assert not organ.surface.GetDisplayNode().GetScalarVisibility()
    assert not legend_of(organ).GetVisibility()
    assert comparisonText(organ) == ""
    # What was found of the surface before stays in the table.
    assert len(rows()) == 1


@pytest.mark.parametrize("cancelled", [False, True])
def test_a_fit_takes_the_colours_away_and_cancelling_brings_them_back(logic, vtk_messages, cancelled):
    from VICRegistrationLib.mrml.comparing import comparisonText
    from VICRegistrationLib.mrml.fitting import fitSteps
    from VICRegistrationLib.mrml.surfaces import moveSurface

    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER], name="bladder")
    logic.compare(organ, surface_model(ellipsoid()))
    colors, text = colors_of(organ).copy(), comparisonText(organ)
    steps = fitSteps(organ, volume)
    moveSurface(organ.surface, next(steps).surface)
    display = organ.surface.GetDisplayNode()
    assert not display.GetScalarVisibility()
    assert not legend_of(organ).GetVisibility()
    if cancelled:
        steps.close()
        assert display.GetScalarVisibility()
        assert legend_of(organ).GetVisibility()
        np.testing.assert_array_equal(colors_of(organ), colors)
        assert comparisonText(organ) == text
    else:
        for step in steps:
            moveSurface(organ.surface, step.surface)
        assert not display.GetScalarVisibility()
        assert comparisonText(organ) == ""
    assert vtk_messages() == ""


def test_a_fit_brings_its_standard_deviation_along(logic):
    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER], name="bladder")
    mesh = triangulate(logic.surface(organ), chord_error=0.1)
    values = vtk_to_numpy(organ.surface.GetPolyData().GetPointData().GetArray(STANDARD_DEVIATION))
    assert values.shape == (len(mesh.points),)
    assert 0.0 < values.min() < values.max() < 4.0
    logic.color(organ, STANDARD_DEVIATION)
    display = organ.surface.GetDisplayNode()
    shown = display.GetScalarRange()
    assert shown[0] == 0.0
    assert shown[1] >= np.percentile(values, 90.0)
    assert display.GetColorNode().GetName() == "Viridis"
    assert legend_of(organ).GetTitleText() == STANDARD_DEVIATION
    # Beside deviations of another organ, and with a range of its own.
    other = add_organ(logic, "other", volume)
    logic.compare(other, surface_model(larger(0.7)))
    assert abs(legend_of(organ).GetPosition()[0] - legend_of(other).GetPosition()[0]) > legend_of(organ).GetSize()[0]
    assert other.surface.GetDisplayNode().GetScalarRange() == (-1.0, 1.0)
    assert display.GetScalarRange() == shown
    # A new fit has such numbers as well, and goes on showing them.
    from VICRegistrationLib.mrml.fitting import fitSteps
    from VICRegistrationLib.registration.steps import finish

    finish(fitSteps(organ, volume))
    assert display.GetScalarVisibility()
    assert display.GetActiveScalarName() == STANDARD_DEVIATION
