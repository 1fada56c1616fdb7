"""The shape of an organ from one place in it, and the choice between it and what is grown from grey levels."""

from __future__ import annotations

import numpy as np
import pytest
from reorientation import ORIENTATIONS, reordered
from scipy import ndimage, sparse
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import dice_coefficient, region_from_mask
from VICRegistrationLib.segmentation import ray_search, star_surface
from VICRegistrationLib.segmentation.edge_support import area_without_edge, edge_support
from VICRegistrationLib.segmentation.ray_graph import cheapest_radii
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.shaped_region import region_within, shaped_region
from VICRegistrationLib.segmentation.sphere import smoothed, sphere
from VICRegistrationLib.segmentation.star_surface import centroid, find_star

RADIUS, WALL_MM = 20.0, 3.0
HALF = 32


def places():
    """Voxels' places (k, j, i), mm from the middle."""
    return np.indices((2 * HALF + 1,) * 3) - float(HALF)


def image_of(array, *, noise=3.0):
    matrix = np.eye(4)
    matrix[:3, 3] = -HALF
    return Image(np.rint(array + noise * np.random.default_rng(0).standard_normal(array.shape)), matrix)


@pytest.fixture(scope="module")
def ball():
    """A bright ball in a dark wall in grey tissue."""
    radius = np.linalg.norm(places(), axis=0)
    levels = np.where(radius < RADIUS, 150.0, np.where(radius < RADIUS + WALL_MM, 30.0, 110.0))
    return image_of(levels), radius < RADIUS


@pytest.fixture(scope="module")
def star(ball):
    """What is found around the middle of the ball."""
    return find_star(ball[0], np.zeros(3))


def region_of_star(image, seeds):
    """Region inside of the star-shaped surface around seeds, and the surface."""
    star = find_star(image, seeds)
    return shaped_region(image, star, seeds), star


def cost_of_radii(ball, costs, prices, radii):
    slopes = prices * np.square(radii[ball.first] - radii[ball.second])
    return costs[np.arange(len(radii)), radii].sum() + slopes.sum() / 2.0


def minimum_cut(ball, costs, prices, most):
    """Radii of least cost: node (n, k) is on the source's side where direction n has more than k radii inside."""
    count, radii = costs.shape
    nodes = np.arange(count * (radii - 1)).reshape(count, radii - 1)
    source, sink, endless = nodes.size, nodes.size + 1, 1000.0
    positive = costs - costs.min()
    edges = [
        (np.full(count, source), nodes[:, 0], positive[:, 0]),
        (nodes[:, -1], np.full(count, sink), positive[:, -1]),
    ]
    edges.append((nodes[:, :-1], nodes[:, 1:], positive[:, 1:-1]))
    edges.append((nodes[:, 1:], nodes[:, :-1], np.full((count, radii - 2), endless)))
    for apart in range(most + 1):
        # Second differences of the square; more than the most apart costs a great deal.
        weight = prices * (1.0 if apart == 0 else 2.0) if apart < most else np.full(len(prices), endless)
        inner, outer = nodes[ball.first][:, apart:], nodes[ball.second][:, : radii - 1 - apart]
        edges.append((inner, outer, np.repeat(weight[:, None], inner.shape[1], axis=1)))
    rows, columns, capacities = (np.concatenate([np.ravel(edge[part]) for edge in edges]) for part in range(3))
    # Capacities are whole numbers.
    capacities = np.rint(1e4 * capacities).astype(np.int32)
    graph = sparse.csr_matrix((capacities, (rows, columns)), shape=(sink + 1, sink + 1))
    left = graph - maximum_flow(graph, source, sink).flow
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    reached = np.isin(nodes, breadth_first_order(left, source, return_predecessors=False))
    return reached.sum(axis=1)


def dice(region, truth):
    mask = region.in_box((0, 0, 0), truth.shape)
    return 2.0 * (mask & truth).sum() / (mask.sum() + truth.sum())


def test_directions_are_symmetric_and_neighbours_go_both_ways():
    ball = sphere()
    flipped = {tuple(np.round(direction, 9) + 0.0) for direction in ball.places * [-1.0, 1.0, 1.0]}
    assert flipped == {tuple(np.round(direction, 9) + 0.0) for direction in ball.places}
    np.testing.assert_array_equal(ball.first[ball.back], ball.second)
    np.testing.assert_array_equal(ball.second[ball.back], ball.first)


def test_radii_follow_the_costs_but_not_a_single_ray_that_has_escaped():
    costs = np.zeros((len(sphere().places), 40))
    costs[:, 20] = -1.0
    costs[7, 20], costs[7, 38] = 0.0, -1.0
    radii = cheapest_radii(sphere(), costs, np.log(1.05) / sphere().distances, smoothness=0.15, most_apart=9)
    assert set(radii.tolist()) == {20}


@pytest.mark.parametrize("seed", range(3))
def test_radii_cost_as_little_as_those_of_a_minimum_cut(seed):
    ball, most, smoothness = sphere(2), 3, 0.3
    rng = np.random.default_rng(seed)
    costs = rng.normal(0.0, 0.4, (len(ball.places), 16))
    # Two sheets, each deeper on one side.
    costs[:, 4] -= 1.0 + 0.5 * ball.places[:, 0]
    costs[:, 11] -= 1.0 - 0.5 * ball.places[:, 0]
    slopes = 0.5 / ball.distances
    radii = cheapest_radii(ball, costs, slopes, smoothness=smoothness, most_apart=most)
    prices = smoothness * slopes**2
    least = cost_of_radii(ball, costs, prices, minimum_cut(ball, costs, prices, most))
    assert cost_of_radii(ball, costs, prices, radii) == pytest.approx(least, abs=0.01)


def test_between_two_levels_the_radii_rise_evenly_as_the_squares_of_their_slopes_cost():
    ball, most, smoothness = sphere(3), 3, 0.3
    costs, slopes, ahead = np.zeros((len(ball.places), 16)), 0.5 / ball.distances, ball.places[:, 0]
    costs[ahead < -0.8, 4] = costs[ahead > 0.8, 10] = -20.0
    radii = cheapest_radii(ball, costs, slopes, smoothness=smoothness, most_apart=most)
    prices = smoothness * slopes**2
    least = cost_of_radii(ball, costs, prices, minimum_cut(ball, costs, prices, most))
    assert cost_of_radii(ball, costs, prices, radii) == pytest.approx(least, rel=1e-3)
    assert np.corrcoef(ahead, radii)[0, 1] > 0.97


def test_slopes_are_counted_from_those_of_a_shape():
    ball, rng = sphere(2), np.random.default_rng(0)
    rays, samples = len(ball.places), np.arange(40)
    shape, costs = rng.integers(0, 9, rays), rng.normal(0.0, 0.4, (rays, 30))
    moved = samples - shape[:, None]
    deeper = np.where((moved >= 0) & (moved < 30), costs[np.arange(rays)[:, None], moved.clip(0, 29)], 100.0)
    slopes = {"smoothness": 0.3, "slopes": 0.5 / ball.distances}
    from_shape = cheapest_radii(ball, costs=deeper, shape=shape, most_apart=20, **slopes)
    np.testing.assert_array_equal(from_shape - shape, cheapest_radii(ball, costs=costs, most_apart=20, **slopes))


def test_smoothed_values_are_harmonics_up_to_the_degree():
    directions, others = sphere(3).places, sphere(2).places
    x, y, z = directions.T
    np.testing.assert_allclose(
        smoothed(directions, 3.0 + x * y - z**3 + x**2 * z**2, others, degree=4),
        3.0 + others[:, 0] * others[:, 1] - others[:, 2] ** 3 + others[:, 0] ** 2 * others[:, 2] ** 2,
        atol=1e-9,
    )
    # A single ray hardly counts.
    assert np.abs(smoothed(directions, np.eye(len(directions))[7], directions, degree=4)).max() < 0.2


def test_a_side_without_any_edge_gets_the_radius_of_the_others():
    costs = np.zeros((len(sphere().places), 80))
    seen = sphere().places[:, 0] < 0.3
    costs[seen, 60] = -1.0
    # An inner sheet of less depth ends half way round.
    costs[sphere().places[:, 0] < -0.3, 30] = -0.7
    radii = cheapest_radii(sphere(), costs, np.log(1.05) / sphere().distances, smoothness=0.15, most_apart=9)
    assert set(radii[seen].tolist()) == {60}
    assert np.abs(radii[~seen] - 60).max() <= 1


@pytest.mark.parametrize("seed", [(14.0, 5.0, 0.0), (0.0, -11.0, 11.0)])
def test_a_shape_does_not_depend_on_the_place_that_was_clicked(ball, seed):
    image, truth = ball
    star = find_star(image, np.array(seed))
    assert star.bright
    np.testing.assert_allclose(centroid(star), 0.0, atol=0.5)
    np.testing.assert_allclose(np.linalg.norm(star.points, axis=1), RADIUS, atol=1.5)
    assert dice(region_within(image, star), truth) > 0.98


def test_a_long_organ_is_seen_from_its_middle_though_its_end_was_clicked():
    k, j, i = places()
    inside = np.hypot(np.hypot(k, j) / 11.0, i / 30.0) < 1.0
    star = find_star(image_of(np.where(inside, 150.0, 50.0)), np.array([26.0, 0.0, 0.0]))
    np.testing.assert_allclose(centroid(star), 0.0, atol=1.5)


def test_a_dark_organ_is_seen_as_well(ball):
    image, truth = ball
    image = Image(300.0 - image.array, image.ijk_to_ras)
    star = find_star(image, np.array([5.0, 5.0, 5.0]))
    assert not star.bright
    assert dice(region_within(image, star), truth) > 0.98


def test_what_is_an_edge_does_not_depend_on_offset_and_scale(ball):
    image, _ = ball
    first, dark, bright = (
        separate(Image(factor * image.array + offset, image.ijk_to_ras), [10.0, 3.0, 2.0])
        for factor, offset in ((1.0, 0.0), (0.01, -1000.0), (100.0, 4000.0))
    )
    for again in (dark, bright):
        assert first.offset == again.offset
        np.testing.assert_array_equal(first.mask, again.mask)


def test_a_dim_patch_under_the_click_is_not_the_organ(ball):
    image, truth = ball
    k, j, i = places()
    patch = np.exp(-((k - 3.0) ** 2 + j**2 + (i + 6.0) ** 2) / (2.0 * 5.0**2))
    dimmed = Image(image.array - 70.0 * patch * truth, image.ijk_to_ras)
    region = separate(dimmed, [-6.0, 0.0, 3.0])
    (differ,) = region.diagnostics
    assert differ.code == "starts_differ"
    assert differ.values["taken_ml"] == differ.values["shaped_ml"] == pytest.approx(region.volume_ml)
    assert f"The one of {region.volume_ml:.1f} ml was taken" in differ.sentence()
    assert dice(region, truth) > 0.97


def star_shaped_voxels(image):
    """Voxels of the star-shaped region in an image, on the grid with the usual axes."""
    region, _ = region_of_star(image, np.array([[33.0, 25.0, 26.0]]))
    return Image(region.in_box((0, 0, 0), image.array.shape), image.ijk_to_ras).canonical().array


@pytest.fixture(scope="module")
def ball_in_slices():
    """A ball in a dark wall in thick slices, and the voxels of its star-shaped region."""
    k, j, i = np.indices((16, 44, 44), dtype=float)
    radius = np.sqrt((4.0 * k - 30.0) ** 2 + (1.2 * j - 25.0) ** 2 + (1.5 * i - 33.0) ** 2)
    levels = np.where(radius < 18.0, 150.0, np.where(radius < 22.0, 30.0, 110.0))
    levels = ndimage.gaussian_filter1d(levels, 0.4, axis=0) + np.random.default_rng(0).normal(0.0, 4.0, levels.shape)
    image = Image(levels.astype(np.float32), np.diag([1.5, 1.2, 4.0, 1.0]))
    return image, star_shaped_voxels(image)


# One order moves every axis, the other swaps two of them, and each axis is flipped.
@pytest.mark.parametrize(("order", "flips"), ORIENTATIONS[6::4])
def test_thick_slices_give_the_same_star_shaped_region_with_other_axes(ball_in_slices, order, flips):
    image, expected = ball_in_slices
    found = star_shaped_voxels(reordered(image, order, flips))
    # Rounding decides single voxels at the limits of grey levels.
    assert np.count_nonzero(found != expected) <= 2


@pytest.mark.parametrize("step_mm", [0.375, 1.5])
def test_the_spacing_of_samples_changes_a_shape_little(monkeypatch, step_mm):
    """Urine darkens over 8 mm; that is no edge, however finely the rays are sampled."""
    (_, j, _), radius = places(), np.linalg.norm(places(), axis=0)
    urine = 150.0 - 90.0 * np.clip((j - 6.0) / 8.0, 0.0, 1.0)
    image = image_of(np.where(radius < RADIUS, urine, np.where(radius < RADIUS + WALL_MM, 30.0, 110.0)))
    monkeypatch.setattr(ray_search, "STEP_MM", step_mm)
    region, _ = region_of_star(image, np.zeros((1, 3)))
    assert dice(region, radius < RADIUS) > 0.98


@pytest.mark.parametrize("least_mm", [7.5, 15.0, 17.5])
def test_a_bright_spot_under_the_click_is_not_the_organ_though_the_wall_is_nearer_than_the_least_radius(
    ball, monkeypatch, least_mm
):
    image, truth = ball
    k, j, i = places()
    spot = k**2 + j**2 + (i + 14.0) ** 2 < 4.0**2
    monkeypatch.setattr(star_surface, "LEAST_MM", least_mm)
    region, star = region_of_star(Image(image.array + 50.0 * spot, image.ijk_to_ras), np.array([[-14.0, 0.0, 0.0]]))
    assert star.radii.min() > RADIUS - 2.0
    assert dice(region, truth) > 0.98


@pytest.mark.parametrize("depth_mm", [5.0, 15.0])
def test_a_large_bright_spot_at_the_wall_is_not_the_organ(depth_mm):
    """From a seed in the spot, the search around its own centroid ends at the spot."""
    step_mm, radius_mm = 2.5, 60.0
    k, j, i = step_mm * (np.indices((57,) * 3) - 28.0)
    radius = np.linalg.norm((k, j, i), axis=0)
    levels = np.where(radius < radius_mm, 150.0, np.where(radius < radius_mm + 4.0, 30.0, 110.0))
    spot = (np.linalg.norm((k, j, i - (radius_mm - 18.0)), axis=0) < 24.0) & (radius < radius_mm)
    matrix = np.diag([step_mm, step_mm, step_mm, 1.0])
    matrix[:3, 3] = -28.0 * step_mm
    levels = levels + 50.0 * spot + np.random.default_rng(0).normal(0.0, 3.0, levels.shape)
    star = find_star(Image(levels.astype(np.float32), matrix), np.array([radius_mm - depth_mm, 0.0, 0.0]))
    np.testing.assert_allclose(np.linalg.norm(star.points, axis=1), radius_mm, atol=4.0)


def test_a_part_that_the_volume_cuts_off_changes_the_cost_of_a_surface_little(ball, star):
    image, _ = ball
    cut = find_star(image.crop((HALF - 5, 0, 0), image.array.shape), np.array([0.0, 0.0, 5.0]))
    assert cut.cut.mean() > 0.25
    assert cut.cost == pytest.approx(star.cost, abs=0.05)


def test_a_dark_band_at_the_wall_with_fat_behind_it_belongs_to_the_organ(ball):
    """The signal falls off gradually towards the wall, where no edge is left but the rise to the fat behind."""
    image, truth = ball
    radius = np.linalg.norm(places(), axis=0)
    off_axis = np.arccos(np.clip(places()[2] / np.maximum(radius, 1e-9), -1.0, 1.0))
    dark = np.exp(-((off_axis / 0.6) ** 2)) / (1.0 + np.exp(-(radius - 11.0) / 2.0))
    dimmed = Image(np.where(radius < RADIUS, image.array * (1.0 - 0.8 * dark), image.array), image.ijk_to_ras)
    star = find_star(dimmed, np.zeros(3))
    np.testing.assert_allclose(np.linalg.norm(star.points, axis=1), RADIUS, atol=2.5)
    assert dice(separate(dimmed, [0.0, 0.0, 0.0]), truth) > 0.97


def test_the_rise_from_a_dark_wall_to_bright_fat_is_no_edge_of_the_organ():
    """It is the sharpest edge of all, and what is behind it would be a dark organ's wall."""
    radius = np.linalg.norm(places(), axis=0)
    levels = np.select([radius < 14.0, radius < 17.0, radius < 23.0], [150.0, 30.0, 250.0], 30.0)
    star = find_star(image_of(ndimage.gaussian_filter(levels, 0.5)), np.array([0.0, 3.0, 0.0]))
    assert star.bright
    np.testing.assert_allclose(np.linalg.norm(star.points, axis=1), 14.0, atol=1.5)


def test_a_lobe_behind_a_bridge_is_left_out(ball):
    image, truth = ball
    k, j, i = places()
    lobe = (k**2 + j**2 + (i - 27.0) ** 2 < 5.0**2) & ~truth
    bridge = (np.hypot(k, j) < 4.0) & (i > 0) & (i < 27)
    leaking = Image(np.where(lobe | bridge, 150.0, image.array), image.ijk_to_ras)
    region = separate(leaking, [0.0, 0.0, 0.0])
    grown = region.image.to_ijk(np.array([[27.0, 0.0, 0.0]]))[0]
    inside = np.all((grown >= 0) & (grown < region.image.size))
    assert not (inside and region.mask[tuple(np.rint(grown[::-1]).astype(int))])
    assert dice(region, truth) > 0.97


def test_a_catheter_and_gas_inside_belong_to_the_organ(ball):
    image, truth = ball
    k, j, i = places()
    dark = ((np.hypot(j, i) < 3.0) & (np.abs(k) < 8.0)) | ((k - 12.0) ** 2 + j**2 + (i - 6.0) ** 2 < 4.0**2)
    region = separate(Image(np.where(dark, 5.0, image.array), image.ijk_to_ras), [-10.0, 0.0, 0.0])
    assert dice(region, truth) > 0.97


def smoothed_noise(seed, sigma):
    matrix = np.eye(4)
    matrix[:3, 3] = -16.0
    noise = np.random.default_rng(seed).standard_normal((32, 32, 32))
    return Image(ndimage.gaussian_filter(noise, sigma), matrix)


def test_a_blob_of_noise_is_no_organ_though_its_boundary_has_an_edge():
    """Its contrast is no larger than that of noise."""
    image = smoothed_noise(seed=2, sigma=0.7)
    assert edge_support(image, *region_of_star(image, np.zeros(3))) > 0.8
    with pytest.raises(ValueError, match="No edge of an organ"):
        separate(image, [0.0, 0.0, 0.0])


def test_a_blob_with_little_of_an_edge_is_no_organ_though_its_contrast_is_large():
    """In noise that is smoothed over several voxels, differences between neighbours are small."""
    image = smoothed_noise(seed=9, sigma=3.0)
    region, star = region_of_star(image, np.zeros(3))
    assert star.contrast > 6.0 * np.median(np.abs(np.diff(image.array, axis=0)))
    assert edge_support(image, region, star) < 0.5
    with pytest.raises(ValueError, match="touches 4 of the six faces"):
        separate(image, [0.0, 0.0, 0.0])


def test_a_boundary_has_the_same_support_a_voxel_farther_in_or_out(ball, star):
    image, truth = ball
    supports = [
        edge_support(image, region_from_mask(image, mask), star)
        for mask in (truth, ndimage.binary_erosion(truth), ndimage.binary_dilation(truth))
    ]
    assert np.ptp(supports) < 0.005
    assert edge_support(image, region_from_mask(image, ndimage.binary_erosion(truth, iterations=5)), star) < 0.3


@pytest.mark.parametrize("radius", [10.0, RADIUS])
def test_the_area_without_an_edge_does_not_depend_on_the_size(ball, star, radius):
    nothing = image_of(np.full_like(ball[0].array, 100.0), noise=0.0)
    mask = np.linalg.norm(places(), axis=0) < radius
    # Faces of voxels have 1.5 times the area of a ball.
    area = 1.5 * (36.0 * np.pi) ** (1.0 / 3.0)
    assert area_without_edge(nothing, region_from_mask(nothing, mask), star) == pytest.approx(area, rel=0.03)
    assert area_without_edge(ball[0], region_from_mask(ball[0], ball[1]), star) < 0.02 * area


def test_lobes_count_even_where_they_have_an_edge(ball):
    image, truth = ball
    lobes = (np.abs(places()[0]) < HALF - 5) & (np.abs(places()[1:]) < 6.0).all(axis=0)
    dark = image.array.copy()
    dark[lobes & ~truth] = 110.0
    image, whole = Image(dark, image.ijk_to_ras), truth | lobes
    star = find_star(image, np.zeros(3))
    areas = [area_without_edge(image, region_from_mask(image, mask), star) for mask in (truth, whole)]
    assert areas[0] < areas[1]


def test_the_right_boundary_has_more_support_than_a_fragment(ball, star):
    image, truth = ball
    whole = region_within(image, star)
    fragment = separate(image, [0.0, 0.0, 0.0], threshold=(149.0, 160.0), erosion=0.0)
    assert edge_support(image, whole, star) > 0.9
    assert edge_support(image, fragment, star) < 0.6
    assert dice_coefficient(whole, whole) == 1.0
    assert dice_coefficient(whole, fragment) < 0.9
    assert dice(whole, truth) > 0.98


@pytest.mark.parametrize("thick", [4, 5])
def test_thick_slices_move_no_edge(thick):
    # Dim surroundings, and dark ones farther off, so that a blurred step is less than half of the contrast in a sample.
    radius = np.linalg.norm(places(), axis=0)
    levels = np.where(radius < RADIUS, 150.0, np.where(np.abs(places()[1]) < 29.0, 100.0, 20.0))
    slices = levels[: len(levels) // thick * thick].reshape(-1, thick, *levels.shape[1:]).mean(axis=1)
    matrix = np.diag([1.0, 1.0, thick, 1.0])
    matrix[:3, 3] = -HALF, -HALF, -HALF + (thick - 1) / 2.0
    star = find_star(Image(image_of(slices).array, matrix), np.zeros(3))
    # A sample of a ray is 0.75 mm long.
    np.testing.assert_allclose(star.radii, RADIUS, atol=0.75)
    assert star.radii.mean() == pytest.approx(RADIUS, abs=0.2)
    assert star.strengths[np.abs(star.directions[:, 2]) > 0.9].mean() > 0.9


def test_the_far_end_of_a_long_organ_is_seen():
    spacing, shape = 2.0, (91, 41, 41)
    k, j, i = (np.indices(shape) - (np.array(shape).reshape(3, 1, 1, 1) - 1) / 2.0) * spacing
    matrix = np.diag([spacing, spacing, spacing, 1.0])
    matrix[:3, 3] = -(np.array(shape[::-1]) - 1) / 2.0 * spacing
    image = Image(np.where((k / 80.0) ** 2 + (j / 30.0) ** 2 + (i / 30.0) ** 2 < 1.0, 150.0, 50.0), matrix)
    star = find_star(image, np.array([0.0, 0.0, 70.0]))
    assert not star.cut.any()
    np.testing.assert_allclose(star.points[:, 2].min(), -80.0, atol=2.0)


def test_a_shape_passes_the_places_that_are_known_of_its_wall():
    # Two sheets; the outer one is fainter, and costs more as the inner one was crossed.
    radius = np.linalg.norm(places(), axis=0)
    image = image_of(np.where(radius < 12.0, 150.0, np.where(radius < RADIUS, 90.0, 30.0)))
    inner = find_star(image, np.zeros(3))
    np.testing.assert_allclose(inner.radii, 12.0, atol=1.0)
    wall = RADIUS * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    outer = find_star(image, np.zeros(3), wall)
    at_wall = (outer.directions @ wall.T / RADIUS).argmax(axis=0)
    np.testing.assert_allclose(outer.radii[at_wall], RADIUS, atol=1.0)


@pytest.fixture(scope="module")
def cut_ball():
    """A ball that the volume cuts in its middle."""
    radius = np.linalg.norm(places(), axis=0)[HALF:]
    image = image_of(np.where(radius < RADIUS, 150.0, np.where(radius < RADIUS + WALL_MM, 30.0, 110.0)))
    return image, radius < RADIUS, np.array([0.0, 0.0, 6.0 - HALF])


def test_where_the_volume_cuts_an_organ_its_shape_goes_on_to_the_volumes_end(cut_ball):
    image, truth, seed = cut_ball
    region, star = region_of_star(image, seed)
    assert star.cut.any()
    # The half ball's own centre of mass, not that of the whole ball.
    assert star.source.point[2] + HALF == pytest.approx(3.0 / 8.0 * RADIUS, abs=1.0)
    assert dice(region, truth) > 0.97


def test_a_shape_that_does_not_hold_the_seeds_is_none(cut_ball):
    image, _, seed = cut_ball
    seeds = np.array([seed, [0.0, 0.0, 25.0 - HALF], [28.0, 28.0, 25.0 - HALF]])
    assert region_of_star(image, seeds)[0] is None
