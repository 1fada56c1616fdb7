"""The table of comparisons: its rows and columns, as CSV, in files, and without the organ."""

from __future__ import annotations

import mrml_boot
import numpy as np
import pytest
import vtk
from mrml_references import (
    DEVIATION,
    add_segmentation,
    colors_of,
    label_image,
    larger,
    legend_of,
    rows,
    surface_model,
    table,
)
from mrml_scenes import slicer
from small_phantom import ellipsoid

from VICRegistrationLib.analysis.comparison import compare

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "few_points")


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


def test_names_come_back_from_a_saved_scene(add_row, scene, tmp_path):
    # Slicer's files of tables lose quotation marks, and take a tab for the next column.
    add_row('P "1"', "bladder", "second\treader")
    path = str(tmp_path / "scene.mrb")
    assert slicer.util.saveScene(path)
    mrml_boot.clear(scene)
    slicer.util.loadScene(path)
    assert names_in_rows() == [("P '1'", "bladder", "second reader")]
    add_row('P "1"', "bladder", "second\treader")
    assert len(rows()) == 1


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


def test_a_copy_of_the_table_is_kept(add_row, scene):
    add_row("P 1", "bladder", "expert")
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(scene)
    logic = slicer.vtkSlicerSubjectHierarchyModuleLogic
    item = logic.CloneSubjectHierarchyItem(hierarchy, hierarchy.GetItemByDataNode(table()))
    copy = hierarchy.GetItemDataNode(item)
    before = copy.GetTable().GetValueByName(0, "Volume Dice").ToDouble()
    add_row("P 1", "bladder", "expert", which=1)
    add_row("P 2", "bladder", "expert")
    assert [name for name, *_ in names_in_rows()] == ["P 1", "P 2"]
    assert (copy.GetScene(), copy.GetNumberOfRows()) == (scene, 1)
    assert copy.GetTable().GetValueByName(0, "Volume Dice").ToDouble() == before != rows()[0]["Volume Dice"]


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
