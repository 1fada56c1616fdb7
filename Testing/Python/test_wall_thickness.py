"""A wall that is thinner than a slice: how thick it is, and what lies behind it, is in the virtual image."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate_volume
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.phantoms.painting import paint
from VICRegistrationLib.registration.cost import Correlation
from VICRegistrationLib.registration.edge_width import edge_width
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.partial_volumes import PartialVolumes
from VICRegistrationLib.registration.sample_grid import SampledSurface, SampleGrid
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.registration.virtual_image import IntensityProfile, VirtualImage
from VICRegistrationLib.registration.wall_thickness import wall_thickness

ORGAN = models.closed_organ((17, 11), axes=np.diag([14.0, 12.0, 24.0]), center=(1.0, 2.0, 3.0))
LUMEN, WALL, FAT = 800.0, 170.0, 550.0
THICK = (0.7, 0.7, 5.0)


def painted(spacing=THICK, wall=3.5, *, offset=0.0, levels=(LUMEN, WALL, FAT)):
    """The organ with a wall of so many mm in fat; its long axis across the slices."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(spacing)
    shape = tuple(int(n) for n in np.ceil(np.array([56.0, 52.0, 84.0]) / spacing)[::-1])
    matrix[:3, 3] = [1.0, 2.0, 3.0] - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1.0) / 2.0 + [0.2, 0.1, 0.3])
    mesh = triangulate_volume(ORGAN, chord_error=0.02)
    outer, inner = (
        volume_fractions(mesh.points + far * mesh.normals, mesh.triangles, shape, matrix) for far in (wall, 0.0)
    )
    inside, of_wall, behind = levels
    return Image(offset + paint(np.full(shape, behind), [(outer, of_wall), (inner, inside)]), matrix)


def thickness(image, surface=ORGAN):
    sampler, voxel = Sampler(image), image.ijk_to_ras[:3, :3]
    return wall_thickness(sampler, surface, voxel, edge_width(sampler, ORGAN, voxel))


@pytest.mark.parametrize("wall", [2.5, 3.5, 4.5])
def test_the_thickness_of_a_wall_is_measured(wall):
    assert thickness(painted(wall=wall)) == pytest.approx(wall, abs=0.25)


def test_a_constant_added_to_the_image_changes_no_thickness():
    assert thickness(painted(offset=4000.0)) == pytest.approx(thickness(painted()), abs=1e-3)


@pytest.mark.parametrize(("spacing", "wall"), [(THICK, 9.0), ((0.7, 0.7, 2.0), 3.5), ((1.0, 1.0, 1.0), 3.5)])
def test_walls_thicker_than_a_voxel_is_long_are_none_of_it(spacing, wall):
    assert thickness(painted(spacing, wall)) is None


@pytest.mark.parametrize("levels", [(800.0, 500.0, 170.0), (170.0, 500.0, 800.0)])
def test_levels_that_fall_or_rise_all_the_way_are_no_wall(levels):
    assert thickness(painted(levels=levels)) is None


@pytest.mark.parametrize("off", [1.0, 2.0, 3.0])
def test_what_lies_between_a_surface_within_the_organ_and_the_edge_is_no_wall(off):
    smaller = ORGAN.with_control_net(ORGAN.control_net - off / 14.0 * (ORGAN.control_net - [1.0, 2.0, 3.0]))
    assert thickness(painted(levels=(LUMEN, WALL, WALL)), smaller) is None


def test_where_nothing_is_seen_there_is_no_wall():
    far = ORGAN.with_control_net(ORGAN.control_net + 500.0)
    assert thickness(painted(), far) is None


def residuals(image, volumes):
    """Root mean square residual of the true surface."""
    edge = edge_width(Sampler(image), ORGAN, image.ijk_to_ras[:3, :3])
    shares = partial(volumes.along, within=0.1)
    virtual = VirtualImage(IntensityProfile(LUMEN, WALL, edge), "local", image.ijk_to_ras[:3, :3], shares)
    surface = SampledSurface(closed_organ(ORGAN), SampleGrid.on(ORGAN, (48, 24)))
    depths = edge * np.linspace(-0.5, 0.5, 5)
    samples = Correlation(Sampler(image), virtual, surface, depths=depths).sample(np.zeros(surface.n_dof))
    return float(np.sqrt(np.mean(samples.residuals**2)))


def test_what_lies_behind_the_wall_is_in_the_virtual_image():
    image = painted()
    # Measured: 1.2 % of the contrast; 3.8 % without.
    assert residuals(image, PartialVolumes(image)) < 0.02


def test_fat_behind_a_thin_wall_makes_no_surface_larger():
    image = painted()
    region = region_from_mask(image, image.array > 650.0, largest_component=True)
    fit = finish(fit_region(image, region))
    # Measured: -0.1 %; +0.5 % if the wall is taken to be without end.
    assert fit.surface.volume() == pytest.approx(ORGAN.volume(), rel=3e-3)
