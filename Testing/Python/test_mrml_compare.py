"""Surfaces compared with segments and models of the scene: numbers, colours, the table, and what cannot be compared."""

from __future__ import annotations

import csv
import io
from types import SimpleNamespace

import mrml_boot
import mrml_scenes
import numpy as np
import pytest
import vtk
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER, ellipsoid
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.analysis.comparison import compare
from VICRegistrationLib.analysis.deviation import ReferenceMesh, mesh_of_mask
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.phantom import volume_fractions

DEVIATION, STANDARD_DEVIATION = "Deviation (mm)", "Standard deviation (mm)"
RIGID = motion(40, (2, -1, 1), (12, -9, 4))
SCALING = np.diag([1.1, 0.9, 1.2, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@pytest.fixture
def logic(slicer_module):
    return mrml_scenes.logic()


@pytest.fixture
def organ(logic):
    """An organ whose surface is the ellipsoid, without a fit."""
    return add_organ(logic, "bladder", mrml_scenes.add_volume())


def add_organ(logic, name, volume, surface=None):
    logic.getParameterNode().volume = volume
    organ = logic.organs().add(name)
    logic.setSurface(organ, surface or ellipsoid())
    return organ


def larger(millimetres, *, shift=(0.0, 0.0, 0.0)):
    """The ellipsoid with longer semi-axes."""
    return closed_organ(axes=np.diag(np.array([14.0, 18.0, 22.0]) + millimetres), center=CENTER + shift)


def add_model(data, name="reference", *, under=None):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", name)
    node.SetAndObserveMesh(data) if data.IsA("vtkUnstructuredGrid") else node.SetAndObservePolyData(data)
    node.CreateDefaultDisplayNodes()
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    return node


def triangles_of(surface, *, chord_error=0.02, moved=lambda points: points):
    from VICRegistrationLib.export.surface_data import polydata

    mesh = triangulate(surface, chord_error=chord_error)
    return polydata(moved(mesh.points), mesh.triangles)


def surface_model(surface, name="reference", *, under=None):
    """A model that carries an exact surface."""
    from VICRegistrationLib.mrml.surfaces import createModel, showSurface

    node = createModel(name, (1.0, 0.0, 0.0))
    showSurface(node, surface, name=name)
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    return node


def label_image(surface, *, spacing=(1.0, 1.0, 2.0), turn=None):
    """A painted image on a grid of its own, cut close around the surface so that it starts away from its origin."""
    mesh = triangulate(surface, chord_error=0.05)
    low, high = mesh.points.min(axis=0) - 6.0, mesh.points.max(axis=0) + 6.0
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if turn is None else turn[:3, :3]) @ np.diag(spacing)
    radius = np.linalg.norm(high - low) / 2.0
    shape = tuple(int(2.0 * radius / step) for step in spacing[::-1])
    matrix[:3, 3] = (low + high) / 2.0 - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    fractions = volume_fractions(mesh.points, mesh.triangles, shape, matrix)
    return Image((fractions >= 0.5).astype(np.uint8), matrix)


def add_segmentation(image, *, under=None, others=()):
    """A segmentation with the segment "s" of an image, and with others that share its label map."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "expert")
    node.CreateDefaultDisplayNodes()
    grid = mrml_scenes.add_volume(image, "grid", under=under)
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    node.SetReferenceImageGeometryParameterFromVolumeNode(grid)
    for name, mask in {"s": image.array, **dict(others)}.items():
        node.GetSegmentation().AddEmptySegment(name, f"segment {name}", [1, 0, 0])
        if mask is not None:
            slicer.util.updateSegmentBinaryLabelmapFromArray(mask, node, name, grid)
    slicer.mrmlScene.RemoveNode(grid)
    return node


def colors_of(organ):
    return vtk_to_numpy(organ.surface.GetPolyData().GetPointData().GetArray(DEVIATION))


def table():
    from VICRegistrationLib.mrml.comparison_table import comparisonTable

    return comparisonTable()


def rows():
    """Rows of the table as texts by the names of their columns, through the clipboard's format."""
    from VICRegistrationLib.mrml.comparison_table import tableAsCsv

    return list(csv.DictReader(io.StringIO(tableAsCsv()[0])))


def legend_of(organ):
    return slicer.modules.colors.logic().GetColorLegendDisplayNode(organ.surface)


# --- numbers ---------------------------------------------------------------------------------------------------------


def test_another_fit_is_compared_by_its_exact_surface(logic, organ):
    other = add_organ(logic, "second fit", logic.getParameterNode().volume, larger(-1.0))
    found = logic.compare(organ, other.surface)
    expected = compare(logic.surface(organ), logic.surface(other))
    assert found.to_surface == expected.to_surface
    assert found.hausdorff == expected.hausdorff
    # One millimetre outside everywhere: an ellipsoid with longer axes is nearly that.
    np.testing.assert_allclose(colors_of(organ), 1.0, atol=0.05)
    # Without the exact surface the triangles, 0.1 mm off, would make it not zero.
    logic.setSurface(other, ellipsoid())
    assert logic.compare(organ, other.surface).hausdorff < 1e-6


def test_a_segment_is_taken_by_its_voxels_on_its_own_grid(logic, organ):
    image = label_image(larger(2.0), turn=motion(30, (1, 2, -1)))
    node = add_segmentation(image)
    content = mrml_scenes.content(slicer.mrmlScene)
    found = logic.compare(organ, node)
    expected = compare(ellipsoid(), mesh_of_mask(image))
    assert found.to_surface.mean == pytest.approx(expected.to_surface.mean, abs=1e-6)
    assert found.hausdorff == pytest.approx(expected.hausdorff, abs=1e-6)
    assert found.reference_ml == pytest.approx(expected.reference_ml, rel=1e-9)
    # Half a voxel is what voxels know.
    assert colors_of(organ).mean() == pytest.approx(-2.0, abs=0.25)
    # The 3D view's surface is smoothed; it is neither made nor taken, and nothing is left behind but the results.
    assert not node.GetSegmentation().ContainsRepresentation("Closed surface")
    added = {entry.split()[0] for entry in mrml_scenes.content(slicer.mrmlScene) if entry not in content}
    assert added == {"vtkMRMLTableNode", "vtkMRMLColorLegendDisplayNode", "item"}


def test_a_segment_that_shares_its_label_map_is_told_from_the_others(logic, organ):
    from VICRegistrationLib.mrml.comparing import comparisonText

    image = label_image(ellipsoid())
    other = np.zeros_like(image.array)
    other[2:5, 2:5, 2:5] = 1
    node = add_segmentation(image, others={"t": other}.items())
    node.GetSegmentation().CollapseBinaryLabelmaps(False)
    assert node.GetSegmentation().GetNumberOfLayers() == 1
    found = logic.compare(organ, node, "segment s")
    assert "pieces" not in comparisonText(organ)
    assert found.volume_dice > 0.95
    assert found.reference_ml == pytest.approx(image.array.sum() * image.voxel_volume / 1000.0, rel=0.05)


def test_stray_pieces_of_a_reference_are_told(logic, organ):
    from VICRegistrationLib.mrml.comparing import comparisonText

    image = label_image(ellipsoid())
    image.array[2:5, 2:5, 2:5] = 1
    logic.compare(organ, add_segmentation(image))
    assert "2 pieces" in comparisonText(organ)
    assert "Islands" in comparisonText(organ)


def test_a_segment_that_came_as_a_surface_is_taken_as_that(logic, organ):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "contours")
    node.CreateDefaultDisplayNodes()
    node.SetSourceRepresentationToClosedSurface()
    node.AddSegmentFromClosedSurfaceRepresentation(triangles_of(ellipsoid()), "organ", [1, 0, 0])
    assert logic.compare(organ, node).hausdorff < 0.05
    assert not node.GetSegmentation().ContainsRepresentation("Binary labelmap")


def test_polygons_and_tetrahedra_are_taken_by_their_outer_triangles(logic, organ):
    grid = vtk.vtkAppendFilter()
    filling = vtk.vtkDelaunay3D()
    filling.SetInputData(triangles_of(ellipsoid(), chord_error=0.5))
    grid.AddInputConnection(filling.GetOutputPort())
    grid.Update()
    assert logic.compare(organ, add_model(grid.GetOutput(), "tetrahedra")).to_surface.mean < 0.5
    box = vtk.vtkCubeSource()
    box.SetCenter(*CENTER)
    box.SetXLength(28.0)
    box.SetYLength(36.0)
    box.SetZLength(44.0)
    box.Update()
    # A box of quadrilaterals whose corners are there three times, around the ellipsoid.
    found = logic.compare(organ, add_model(box.GetOutput(), "box"))
    assert found.reference_ml == pytest.approx(28 * 36 * 44 / 1000.0, rel=1e-6)
    # A B-spline surface is an ellipsoid to 0.02 mm.
    assert colors_of(organ).max() < 0.03


# --- transforms ------------------------------------------------------------------------------------------------------


def places(kind):
    """A transform node or None, and the functions that take points below it to the world and back."""
    if kind is None:
        return None, lambda points: points, lambda points: points
    if kind == "bent":
        spline = mrml_scenes.thin_plate_spline()
        back = spline.GetInverse()
        return (
            mrml_scenes.add_nonlinear_transform(spline),
            lambda points: mrml_scenes.through(spline, points),
            lambda points: mrml_scenes.through(back, points),
        )
    matrix = {"moved": RIGID, "stretched": RIGID @ SCALING, "mirrored": MIRROR}[kind]
    inverse = np.linalg.inv(matrix)
    return (
        mrml_scenes.add_linear_transform(matrix),
        lambda points: points @ matrix[:3, :3].T + matrix[:3, 3],
        lambda points: points @ inverse[:3, :3].T + inverse[:3, 3],
    )


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("moved", None),
        (None, "moved"),
        ("moved", "stretched"),
        (None, "mirrored"),
        ("bent", "moved"),
        ("moved", "bent"),
    ],
)
def test_a_mesh_is_brought_to_where_the_surface_lies(logic, ours, theirs):
    organ_under, to_world, _ = places(ours)
    mesh_under, _, from_world = places(theirs)
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=organ_under))
    # What is seen in the same place of the world.
    seen = triangles_of(larger(1.0), moved=lambda points: from_world(to_world(points)))
    found = logic.compare(organ, add_model(seen, under=mesh_under))
    expected = compare(ellipsoid(), larger(1.0))
    assert found.to_surface.mean_signed == pytest.approx(expected.to_surface.mean_signed, abs=0.02)
    np.testing.assert_allclose(colors_of(organ), -1.0, atol=0.1)
    assert found.volume_dice == pytest.approx(expected.volume_dice, abs=0.003)


@pytest.mark.parametrize(("ours", "theirs"), [("moved", "stretched"), (None, "mirrored"), ("moved", "bent")])
def test_an_exact_surface_is_brought_to_where_the_other_lies(logic, ours, theirs):
    organ_under, to_world, _ = places(ours)
    their_under, _, from_world = places(theirs)
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=organ_under))
    other = surface_model(ellipsoid(), under=their_under)
    found = logic.compare(organ, other)
    # The same, by points that are taken there one by one.
    _, to_world_theirs, _ = places(theirs)
    _, _, from_world_ours = places(ours)
    mesh = triangulate(ellipsoid(), chord_error=0.01)
    moved = ReferenceMesh(from_world_ours(to_world_theirs(mesh.points)), mesh.triangles)
    expected = compare(ellipsoid(), moved)
    # The points of both are drawn by lot: 10,000 of them know the mean to one hundredth of the spread.
    assert found.to_surface.mean == pytest.approx(expected.to_surface.mean, abs=0.03 * expected.to_surface.std)
    assert found.volume_dice == pytest.approx(expected.volume_dice, abs=0.003)


@pytest.mark.parametrize(("ours", "theirs"), [("moved", None), (None, "moved"), ("bent", "moved"), ("moved", "bent")])
def test_a_segment_is_brought_to_where_the_surface_lies(logic, ours, theirs):
    organ_under, to_world, _ = places(ours)
    segment_under, _, from_world = places(theirs)
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=organ_under))
    mesh = triangulate(ellipsoid(), chord_error=0.05)
    points = from_world(to_world(mesh.points))
    grid = label_image(closed_organ(axes=np.diag([26.0, 26.0, 26.0]), center=points.mean(axis=0)))
    fractions = volume_fractions(points, mesh.triangles, grid.array.shape, grid.ijk_to_ras)
    node = add_segmentation(Image((fractions >= 0.5).astype(np.uint8), grid.ijk_to_ras), under=segment_under)
    found = logic.compare(organ, node, "s")
    assert found.to_surface.mean < 0.4
    assert abs(found.to_surface.mean_signed) < 0.1
    assert found.volume_dice > 0.95


def test_below_one_bending_transform_nothing_is_bent(logic):
    under, _, _ = places("bent")
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=under))
    assert logic.compare(organ, surface_model(ellipsoid(), under=under)).hausdorff < 1e-6


# --- colours ---------------------------------------------------------------------------------------------------------


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
    with pytest.raises(ValueError, match=r"no numbers named Standard deviation \(mm\)"):
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


def test_a_fit_that_knows_how_sure_it_is_brings_the_standard_deviation_along(logic, monkeypatch):
    from VICRegistrationLib.registration import organ as recipe

    def sure(fit):
        """Add a confidence to a fit: the standard deviation grows with u."""
        object.__setattr__(fit, "confidence", SimpleNamespace(standard_deviation=lambda places: 0.1 + places[:, 0]))
        return fit

    def fit_region(*arguments, real=recipe.fit_region, **options):
        return sure((yield from real(*arguments, **options)))

    monkeypatch.setattr(recipe, "fit_region", fit_region)
    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER], name="bladder")
    mesh = triangulate(logic.surface(organ), chord_error=0.1)
    values = vtk_to_numpy(organ.surface.GetPolyData().GetPointData().GetArray(STANDARD_DEVIATION))
    np.testing.assert_allclose(values, 0.1 + mesh.parameters[:, 0])
    logic.color(organ, STANDARD_DEVIATION)
    display = organ.surface.GetDisplayNode()
    assert display.GetScalarRange() == (0.0, 2.0)
    assert display.GetColorNode().GetName() == "Viridis"
    assert legend_of(organ).GetTitleText() == STANDARD_DEVIATION
    # Beside deviations of another organ, and with a range of its own.
    other = add_organ(logic, "other", volume)
    logic.compare(other, surface_model(larger(0.7)))
    assert abs(legend_of(organ).GetPosition()[0] - legend_of(other).GetPosition()[0]) > legend_of(organ).GetSize()[0]
    assert other.surface.GetDisplayNode().GetScalarRange() == (-1.0, 1.0)
    assert display.GetScalarRange() == (0.0, 2.0)
    # A new fit has such numbers as well, and goes on showing them.
    from VICRegistrationLib.mrml.fitting import fitSteps

    recipe.finish(fitSteps(organ, volume))
    assert display.GetScalarVisibility()
    assert display.GetActiveScalarName() == STANDARD_DEVIATION


# --- table -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured():
    """Two comparisons that were made beforehand."""
    return compare(ellipsoid(), larger(1.0), n_points=500), compare(ellipsoid(), larger(2.0), n_points=500)


@pytest.fixture
def add_row(slicer_module, measured):
    """Function that writes one of them into the table; the names are those of patient, organ and reference."""
    from VICRegistrationLib.mrml.comparison_table import addComparison

    def add(*names, which=0):
        return addComparison(measured[which], **dict(zip(("patient", "organ", "reference"), names)))

    return add


def names_in_rows():
    return [tuple(row[name] for name in ("Patient", "Organ", "Reference")) for row in rows()]


def test_a_row_for_every_organ_patient_and_reference(add_row, measured):
    names = [("P 1", "bladder", "expert"), ("P 1", "bladder", "second"), ("P 2", "bladder", "second")]
    names.append(("P 1", "rectum", "second"))
    for each in names:
        add_row(*each)
    assert names_in_rows() == names
    # Comparing again replaces the row in its place.
    add_row(*names[1], which=1)
    assert names_in_rows() == names
    found = [float(row["Signed mean (mm)"]) for row in rows()]
    assert found == pytest.approx([measured[k].to_surface.mean_signed for k in (0, 1, 0, 0)], abs=1e-4)
    assert slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLTableNode") == 1


def test_a_row_is_named_after_patient_organ_and_reference(logic, organ):
    segmentation, model = add_segmentation(label_image(larger(1.0))), surface_model(larger(0.5), "second reader")
    logic.compare(organ, segmentation)
    logic.compare(organ, model, patient="P 2")
    assert names_in_rows() == [("mri", "bladder", "expert: segment s"), ("P 2", "bladder", "second reader")]


def test_the_columns_say_what_they_hold_and_in_which_unit(logic, organ):
    found = logic.compare(organ, surface_model(larger(1.0)))
    (row,) = rows()
    expected = {
        "Mean to surface (mm)": found.to_surface.mean,
        "Standard deviation to surface (mm)": found.to_surface.std,
        "RMS to surface (mm)": found.to_surface.rms,
        "Median to surface (mm)": found.to_surface.median,
        "95 % to surface (mm)": found.to_surface.p95,
        "Mean to reference (mm)": found.to_reference.mean,
        "95 % to reference (mm)": found.to_reference.p95,
        "Signed mean (mm)": found.to_surface.mean_signed,
        "Hausdorff (mm)": found.hausdorff,
        **{f"Surface Dice at {tolerance:g} mm": share for tolerance, share in found.surface_dice},
        "Volume Dice": found.volume_dice,
        "Volume (ml)": found.volume_ml,
        "Reference volume (ml)": found.reference_ml,
        "Volume difference (ml)": found.volume_difference_ml,
    }
    assert list(row) == ["Patient", "Organ", "Reference", *expected]
    for name, value in expected.items():
        assert float(row[name]) == pytest.approx(value, abs=1e-4), name
        # Numbers are numbers in Slicer as well, to be sorted and plotted.
        assert table().GetTable().GetColumnByName(name).IsA("vtkDoubleArray")
    assert expected["Signed mean (mm)"] == pytest.approx(-1.0, abs=0.05)


def test_columns_and_rows_of_others_stay(add_row):
    add_row("P 1", "bladder", "expert")
    notes = vtk.vtkStringArray()
    notes.SetName('Note, "quoted"')
    notes.InsertNextValue("a line\nand another")
    table().GetTable().AddColumn(notes)
    table().GetTable().RemoveColumnByName("Volume Dice")
    add_row("P 1", "bladder", "expert")
    add_row("P 2", "bladder", "expert")
    assert [row['Note, "quoted"'] for row in rows()] == ["a line\nand another", ""]
    assert all(0.0 < float(row["Volume Dice"]) < 1.0 for row in rows())


def test_a_table_that_was_removed_is_made_again_and_one_of_that_name_is_let_be(add_row):
    theirs = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTableNode", "VIC comparison")
    add_row("P 1", "bladder", "expert")
    assert theirs.GetNumberOfRows() == 0
    table().SetName("renamed")
    add_row("P 1", "bladder", "expert")
    assert len(rows()) == 1
    slicer.mrmlScene.RemoveNode(table())
    add_row("P 1", "bladder", "expert")
    assert len(rows()) == 1
    assert table().GetName() == "VIC comparison"


def test_tables_of_scenes_that_were_loaded_together_are_joined(add_row, scene, tmp_path):
    path = str(tmp_path / "scene.mrb")
    add_row("P 1", "bladder", "expert")
    add_row("P 2", "bladder", "expert")
    assert slicer.util.saveScene(path)
    mrml_boot.clear(scene)
    add_row("P 0", "bladder", "expert")
    add_row("P 1", "bladder", "expert")
    slicer.util.loadScene(path)
    assert scene.GetNumberOfNodesByClass("vtkMRMLTableNode") == 2
    assert [name for name, *_ in names_in_rows()] == ["P 0", "P 1", "P 2"]
    assert scene.GetNumberOfNodesByClass("vtkMRMLTableNode") == 1
    assert len({row["Volume Dice"] for row in rows()}) == 1


def test_without_a_comparison_there_is_nothing_to_copy(logic, organ):
    from VICRegistrationLib.mrml.comparison_table import tableAsCsv

    with pytest.raises(ValueError, match="no comparison.*Press Compare"):
        tableAsCsv()


def test_the_patient_is_kept_with_the_volume(logic, organ):
    from VICRegistrationLib.mrml.comparing import patientOf, setPatient

    volume = logic.getParameterNode().volume
    assert (patientOf(volume), patientOf(None)) == ("mri", "")
    setPatient(volume, " Müller, A. ")
    assert patientOf(volume) == "Müller, A."
    logic.compare(organ, surface_model(larger(1.0)))
    assert rows()[0]["Patient"] == "Müller, A."
    setPatient(volume, " ")
    assert patientOf(volume) == "mri"


def test_removing_the_organ_removes_its_legend_and_keeps_the_results(logic, organ):
    reference = add_segmentation(label_image(larger(1.0)))
    logic.compare(organ, reference)
    logic.organs().remove(organ)
    assert len(rows()) == 1
    assert reference.GetScene() is not None
    assert slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLColorLegendDisplayNode") == 0
    assert slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLModelNode") == 0


def test_table_colours_and_reference_come_back_from_a_bundle(logic, organ, scene, tmp_path):
    from VICRegistrationLib.mrml.colors import coloredBy
    from VICRegistrationLib.mrml.comparing import comparisonText, setPatient

    setPatient(logic.getParameterNode().volume, "Müller")
    reference = add_segmentation(label_image(larger(1.0)))
    logic.compare(organ, reference)
    values, display = colors_of(organ).copy(), organ.surface.GetDisplayNode()
    before, text, limits = rows(), comparisonText(organ), display.GetScalarRange()
    assert slicer.util.saveScene(str(tmp_path / "scene.mrb"))
    mrml_boot.clear(scene)
    slicer.util.loadScene(str(tmp_path / "scene.mrb"))
    (organ,) = logic.organs()
    np.testing.assert_array_equal(colors_of(organ), values)
    assert coloredBy(organ.surface) == DEVIATION
    assert organ.surface.GetDisplayNode().GetScalarRange() == limits
    assert organ.surface.GetDisplayNode().GetColorNode().GetName() == "DivergingBlueRed"
    assert legend_of(organ).GetVisibility()
    assert comparisonText(organ) == text
    (old,), (row,) = before, rows()
    assert table().GetTable().GetColumnByName("Volume Dice").IsA("vtkDoubleArray")
    assert list(row) == list(old)
    for name, value in old.items():
        # Tables are written with 6 digits.
        assert (
            row[name] == value
            if name in ("Patient", "Organ", "Reference")
            else float(row[name]) == pytest.approx(float(value), rel=1e-5, abs=1e-4)
        )
    # Work goes on: the row is found again, and a new one gets numbers.
    node, segmentId = organ.reference()
    assert (node.GetName(), segmentId) == ("expert", "s")
    logic.compare(organ, node, segmentId)
    assert len(rows()) == 1
    found = logic.compare(organ, node, segmentId, patient="another")
    assert float(rows()[1]["Hausdorff (mm)"]) == pytest.approx(found.hausdorff, abs=1e-4)


# --- what cannot be compared -----------------------------------------------------------------------------------------


def open_triangles():
    data = triangles_of(ellipsoid(), chord_error=0.5)
    data.BuildLinks()
    data.DeleteCell(3)
    data.RemoveDeletedCells()
    return data


def removed(node):
    slicer.mrmlScene.RemoveNode(node)
    return node


BAD = {
    "nothing": (lambda organ: None, "No reference is chosen.*Choose one"),
    "removed": (lambda organ: removed(surface_model(ellipsoid())), "No reference is chosen"),
    "itself": (lambda organ: organ.surface, "is the surface of the organ itself"),
    "volume": (lambda organ: mrml_scenes.add_volume(name="grey"), "grey is no reference"),
    "no segment": (lambda organ: add_segmentation(label_image(ellipsoid()), others=[("t", None)]), "No segment of exp"),
    "no points": (
        lambda organ: slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "void"),
        "void has no triangles",
    ),
    "points": (lambda organ: add_model(vtk.vtkPolyData()), "reference has no triangles"),
    "open": (lambda organ: add_model(open_triangles()), "reference: The mesh is open"),
    "far": (lambda organ: surface_model(larger(0.0, shift=(100.0, 0.0, 0.0))), r"do not overlap, they are 7\d\.\d mm"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_compared_is_told_and_leaves_nothing(logic, organ, what):
    make, message = BAD[what]
    reference = make(organ)
    content, colors = mrml_scenes.content(slicer.mrmlScene), organ.surface.GetPolyData().GetPointData()
    with pytest.raises(ValueError, match=message):
        logic.compare(organ, reference)
    assert mrml_scenes.content(slicer.mrmlScene) == content
    assert not colors.HasArray(DEVIATION)
    assert organ.reference() == (None, "")


@pytest.mark.parametrize("cleared", [False, True])
def test_an_empty_segment_is_told(logic, organ, cleared):
    node = add_segmentation(label_image(ellipsoid()), others=[("t", None)])
    if cleared:
        slicer.vtkSlicerSegmentationsModuleLogic.ClearSegment(node, "s")
    with pytest.raises(ValueError, match="is empty.*paint it"):
        logic.compare(organ, node, "s" if cleared else "t")


def test_a_segment_far_away_is_told(logic, organ):
    node = add_segmentation(label_image(larger(0.0, shift=(0.0, 0.0, 90.0))))
    with pytest.raises(ValueError, match="bladder and expert: segment s do not overlap, they are 4.* transforms"):
        logic.compare(organ, node)


def test_an_organ_without_a_surface_is_told(logic):
    logic.getParameterNode().volume = mrml_scenes.add_volume()
    organ = logic.organs().add("bladder")
    with pytest.raises(ValueError, match="no surface yet.*Fit it first"):
        logic.compare(organ, surface_model(ellipsoid()))
    with pytest.raises(ValueError, match="no surface yet"):
        logic.color(organ, DEVIATION)


def test_a_segment_of_one_voxel_has_a_surface_too(logic, organ):
    image = label_image(ellipsoid())
    single = np.zeros_like(image.array)
    single[tuple(size // 2 for size in single.shape)] = 1
    node = add_segmentation(Image(single, image.ijk_to_ras))
    assert logic.compare(organ, node).reference_ml < 0.01
