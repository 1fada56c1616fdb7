"""The verdict of a fit: good, check or poor, and why."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from small_phantom import SEED, ellipsoid_image

from VICRegistrationLib import cli
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.choices import Choice
from VICRegistrationLib.registration.verdict import verdict_of


def judged(*diagnostics, choices=()):
    verdict = verdict_of(SimpleNamespace(choices=choices), diagnostics)
    return verdict.word, [reason.code for reason in verdict.reasons]


@pytest.mark.parametrize(("share", "word"), [(0.2, "good"), (0.4, "check"), (0.8, "poor")])
def test_the_area_without_an_edge_decides(share, word):
    reasons = [] if word == "good" else ["no_edge_in_places"]
    assert judged(Diagnostic("no_edge_in_places", {"share": share})) == (word, reasons)


def test_the_worst_reason_comes_first():
    border = Diagnostic("reaches_border", {"share": 0.01})
    found = [Diagnostic("starts_differ", {}), border, Diagnostic("volume_differs", {})]
    assert judged(*found) == ("poor", ["volume_differs", "starts_differ"])


@pytest.mark.parametrize(("first", "axis"), [(0, 2), (0, 1), (0, 0), (-1, 2), (-1, 1), (-1, 0)])
@pytest.mark.parametrize(("depth", "word"), [(1.0, "good"), (4.0, "check")])
def test_an_organ_that_the_border_cuts_is_checked(first, axis, depth, word):
    spacing, radius = np.array([1.0, 0.5, 2.0]), 12.0
    size = np.array([32, 64, 16])
    places = np.stack(np.meshgrid(*(spacing[a] * np.arange(size[a]) for a in range(3)), indexing="ij"), axis=-1)
    center = spacing * (size - 1) / 2.0
    center[axis] = radius - depth if first == 0 else spacing[axis] * (size[axis] - 1) - radius + depth
    mask = (np.linalg.norm(places - center, axis=-1) < radius).transpose(2, 1, 0)
    image = Image(np.zeros(mask.shape), np.diag([*spacing, 1.0]))
    region = region_from_mask(image, mask)
    assert region.touches_border == ("ijk"[axis] + ("-" if first == 0 else "+"),)
    surface = closed_organ(axes=radius * np.eye(3), center=center)
    # A cap of a ball, by as many voxels as lie in its circle.
    circle = np.pi * depth * (2.0 * radius - depth)
    np.testing.assert_allclose(region.border_area, circle, rtol=0.15)
    reasons = [] if word == "good" else ["reaches_border"]
    assert judged(Diagnostic("reaches_border", {"share": region.border_area / surface.area()})) == (word, reasons)


def test_what_was_kept_of_a_fit_counts():
    closer = Choice("drift limit", "10 times closer", (Diagnostic("held_closer", {"net": "9x7", "factor": 10.0}),))
    kept = Diagnostic("surface_kept", {"net": "9x7", "kept": "closed surface of the region"})
    assert judged(choices=[closer]) == ("check", ["held_closer"])
    assert judged(choices=[closer, Choice("drift limit", "kept", (kept,))])[0] == "poor"


def test_it_is_in_the_report_and_strict_ends_with_3(tmp_path, capsys):
    write_image(ellipsoid_image(), tmp_path / "mri.nii.gz")
    words = ["fit", str(tmp_path / "mri.nii.gz"), "--organ", "bladder", "--no-pictures", "--quiet", "--strict"]
    words += ["--seed", SEED, "--output", str(tmp_path / "out")]
    assert cli.main(words) == 0
    entry = json.loads((tmp_path / "out" / "report.json").read_text())["organs"]["bladder"]
    assert (entry["verdict"], entry["verdict_reasons"]) == ("good", [])
    noise = ellipsoid_image()
    flat = type(noise)(200.0 * np.random.default_rng(0).random(noise.array.shape), noise.ijk_to_ras)
    write_image(flat, tmp_path / "noise.nii.gz")
    matrix = noise.ijk_to_ras
    label = type(noise)((noise.array > 450.0).astype(np.uint8), matrix)
    write_image(label, tmp_path / "label.nii.gz")
    words[1], words[-1] = str(tmp_path / "noise.nii.gz"), str(tmp_path / "none")
    words[words.index("--seed") : words.index("--output")] = ["--region", str(tmp_path / "label.nii.gz")]
    assert cli.main(words) == 3
    assert "the verdict is poor: bladder" in capsys.readouterr().err
