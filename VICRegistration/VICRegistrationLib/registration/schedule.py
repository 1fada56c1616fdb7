"""The schedule of an organ's fit: its images, and the stages that are run on them, from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.moments import Moments, ball_radius
from ..imaging.region import Region
from ..imaging.sampling import Sampler
from .levels import levels_of_region, measured_levels
from .options import MAX_ITERATIONS, MOST_TAU_PIXELS, TAU_PIXELS, FitOptions
from .partial_volumes import PartialVolumes
from .region_image import RegionImage, region_image
from .stack_view import View
from .stages import Stage
from .virtual_image import IntensityProfile, VirtualImage

# Width of the surroundings of the region in its distance image, mm. Half and twice of it change the mean distances of
# the demo's organs and of four real bladders by 0.014 mm at most, because the voxels of the distance image change.
REGION_MARGIN_MM = 10.0
# Weights against sliding within the surface and against leaving the separated region; 1 is about the weight of a sharp
# edge. Tried 0.01 to 0.2 on phantoms and real bladders: larger weights keep the surface from its edge, smaller ones let
# control points drift, and let the surface drift where there is no edge. Without ANCHOR no first fit changes. Of two
# bladders that are fitted again after a displacement of 1.6 mm, the error of one becomes 0.88 in place of 0.72 mm, that
# of the other 0.69 in place of 0.76 mm.
SLIDING = 0.02
ANCHOR = 0.05
# Weight of the thin-plate energy on the region if a voxel were as large as the organ; it falls with the square of the
# voxel's size relative to the organ. Tried 0.08 to 0.5 on phantoms in slices of 4 mm and real bladders in slices of
# 1 mm: with less the terraces of the slices remain, with more the organ's corners are cut off.
REGION_BENDING = 0.3
# A stage ends when an iteration lowers its cost by less than this fraction: on the grey levels, and on the region,
# where the later stages on the grey levels correct the rest. Half and twice of both change these distances by 0.008 mm
# at most. Twice of the first saves 11 % of the iterations, but one of three hippocampi then keeps a coarser net.
COST_TOLERANCE = 3e-3
REGION_COST_TOLERANCE = 2e-2
# Tolerance of the stage that fits boundary points: largest displacement of a control point in an iteration, mm.
BOUNDARY_TOLERANCE = 0.02
# Smoothness before the noise was measured. Half and twice of it change these distances by 0.002 mm at most.
SMOOTHNESS_TO_START = 1e-5
# Partial volumes are computed again when the surface has moved by more than so many pixels, in the coarse and in the
# fine stage. Half and twice of the first change no mean distance of the demo and of three real bladders. Half of the
# second changes none by more than 0.002 mm; with twice of it the demo's rectum is off by 0.08 in place of 0.06 mm, as
# the finest net is then judged with partial volumes of the coarser one, and refused. With 0 the surface that is judged
# has partial volumes that follow its own noise, and a smooth organ of poor contrast gets the finest net.
_NEAR_COARSE, _NEAR_FINE = 4.0, 0.125
# Width of the coarse stage's ramp, in widths of the edge. With 1, surfaces that begin 2.5 mm inside of the demo's
# bladder and rectum end 0.7 and 0.9 mm off, in place of 0.04 and 0.07 mm.
_COARSE_WIDENING = 1.5
# Smallest tau that is accepted, in voxels.
_LEAST_TAU = 0.1


@dataclass(frozen=True, eq=False)
class Schedule:
    """Images and options from which the stages of one organ's fit are made.

    Parameters
    ----------
    sampler : Sampler
        The grey levels around the organ, in the frame of the fit.
    volumes : PartialVolumes
        Of surfaces in the voxels of that image.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel in that frame, mm.
    inside, outside : float
        Typical grey levels on both sides of the organ's boundary.
    options : FitOptions
        With `tau`, `smoothness` and `max_iterations` filled in; before they are chosen they have initial values.
    region : RegionImage, optional
        The separated region; None if the fit starts from a given surface.
    anchor : float
        Weight against leaving the surface with which a stage on the grey levels begins.
    views : tuple of View
        Further stacks of the organ.
    """

    sampler: Sampler
    volumes: PartialVolumes
    voxel: np.ndarray
    inside: float
    outside: float
    options: FitOptions
    region: RegionImage | None = None
    anchor: float = ANCHOR
    views: tuple[View, ...] = ()

    @classmethod
    def of_region(cls, image: Image, region: Region, pose: Moments, options: FitOptions) -> Schedule:
        """Make the schedule for a separated region, in the frame of its principal axes.

        Parameters
        ----------
        image : Image
        region : Region
        pose : Moments
            Of the region.
        options : FitOptions

        Returns
        -------
        Schedule

        Raises
        ------
        ValueError
            If the region does not lie on the image's grid, is thinner than tau or has no surroundings, or if tau is
            much smaller than a voxel.
        """
        _check_grid(image, region)
        pixel = float(min(image.spacing))
        _check_tau(options.tau, pixel)
        _check_thickness(pose, options.tau or TAU_PIXELS * pixel)
        local_to_ras = frame_of(pose)
        target = region_image(region, local_to_ras, margin=REGION_MARGIN_MM)
        reach = 4.0 * (options.tau or MOST_TAU_PIXELS * pixel)
        sampler = Sampler(_local_crop(image, region, local_to_ras, margin=reach))
        levels = levels_of_region(target, sampler, reach, options)
        voxel = np.linalg.inv(local_to_ras[:3, :3]) @ image.ijk_to_ras[:3, :3]
        return cls(sampler, PartialVolumes(sampler.image), voxel, *levels, _as_to_start(options, pixel), target)

    @classmethod
    def around(
        cls, image: Image, surface: BSplineSurface, options: FitOptions, *, points: np.ndarray | None = None
    ) -> Schedule:
        """Make the schedule for a fit that starts from a given surface, in RAS mm.

        Parameters
        ----------
        image : Image
        surface : BSplineSurface
            Near the edge, RAS mm.
        options : FitOptions
        points : (n, 3) ndarray, optional
            Boundary points, RAS mm.

        Returns
        -------
        Schedule

        Raises
        ------
        ValueError
            If the surface lies outside of the volume.
        """
        pixel = float(min(image.spacing))
        net = surface.control_net.reshape(-1, 3)
        reach = 4.0 * (options.tau or MOST_TAU_PIXELS * pixel)
        sampler = Sampler(image.crop_around(net if points is None else np.concatenate([net, points]), reach))
        options = _as_to_start(options, pixel)
        given = options.levels == "given"
        levels = (options.inside, options.outside) if given else measured_levels(surface, sampler, options.tau)
        return cls(sampler, PartialVolumes(sampler.image), image.ijk_to_ras[:3, :3], *levels, options)

    def chosen(self, *, anchor: float | None = None, **options) -> Schedule:
        """Copy with other options, and perhaps another anchor."""
        anchor = self.anchor if anchor is None else anchor
        return replace(self, options=self.options.filled_in(**options), anchor=anchor)

    def without_partial_volumes(self) -> Schedule:
        """Copy without the partial volumes that were computed so far."""
        return replace(self, volumes=PartialVolumes(self.sampler.image))

    def closer(self, factor: float) -> Schedule:
        """Copy with smoothness and anchor multiplied by a factor."""
        return self.chosen(smoothness=factor * self.options.smoothness, anchor=factor * self.anchor)

    @property
    def pixel(self) -> float:
        """Finest voxel spacing, mm."""
        return float(np.linalg.norm(self.voxel, axis=0).min())

    def voxels_along(self, surface: BSplineSurface) -> float:
        """Count the voxels of all images in a band of width tau around a surface."""
        own = surface.area() * self.options.tau / abs(float(np.linalg.det(self.voxel)))
        return own + sum(view.voxels_along(surface) for view in self.views)

    # ------------------------------------------------------------------ stages

    @property
    def scaling(self) -> Stage:
        """Global scaling on the region."""
        return Stage("global scaling", stop_rule="parameters", reach=0.15, **self._on_region)

    @property
    def on_region(self) -> Stage:
        """Local registration on the region."""
        tolerance = self._patience[0] * 3.0 * self.options.tolerance
        coarseness = float(np.mean(np.sum(self.voxel**2, axis=0))) / ball_radius(self.region.volume) ** 2
        bending = 0.0 if self.options.smoothness == 0.0 else REGION_BENDING * coarseness
        return Stage(
            "region",
            reach=0.02,
            bending=bending,
            tolerance=tolerance,
            boundary=self._known_boundary,
            **self._on_region,
        )

    @property
    def coarse(self) -> Stage:
        """Local registration on the grey levels, over a wider ramp."""
        return self._on_grey_levels("grey levels, coarse", widening=_COARSE_WIDENING, loosening=3.0, near=_NEAR_COARSE)

    @property
    def fine(self) -> Stage:
        """Local registration on the grey levels."""
        return self._on_grey_levels("grey levels, fine", widening=1.0, loosening=1.0, near=_NEAR_FINE)

    @property
    def to_boundary_points(self) -> Stage:
        """Correction by boundary points, against the grey levels around them."""
        rules = {"solver": "gauss-newton", "tolerance": BOUNDARY_TOLERANCE, "cost_tolerance": 0.0}
        return replace(self.fine, name="boundary points", **rules)

    @property
    def _known_boundary(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Points of the region's boundary that the organ has too, and their areas; None if there are none.

        The region ends where the volume ends, the organ does not. With several stacks no point is used: the region is
        that of the first one, and the surface of a real bladder that is drawn to its boundary is 0.3 mm from the edges
        in a second stack.
        """
        if self.views:
            return None
        points, areas = self.region.boundary
        known = self.sampler.values(points)[1]
        return (points[known], areas[known]) if known.any() else None

    @property
    def _on_region(self) -> dict:
        """Settings of both stages on the region."""
        extent = self.region.extent
        profile = IntensityProfile(-extent, extent, 2.0 * extent, ramp="linear")
        return {
            "sampler": self.region.sampler,
            "virtual": VirtualImage(profile, mode="given"),
            "n_depths": 3,
            "cost_tolerance": self._patience[1] * REGION_COST_TOLERANCE,
            "sliding": SLIDING,
            "solver": self.options.solver,
            "max_iterations": self.options.max_iterations,
        }

    def _on_grey_levels(self, name: str, *, widening: float, loosening: float, near: float) -> Stage:
        """Make a stage on the grey levels.

        Parameters
        ----------
        name : str
        widening, loosening : float
            Factors for the width of the ramp and for the tolerances.
        near : float
            Partial volumes are computed again when the surface has moved by more than so many pixels.
        """
        within = near * self.pixel
        options, (patience, patience_cost) = self.options, self._patience
        profile = IntensityProfile(
            self.inside, self.outside, widening * options.tau, centered=options.profile == "centered"
        )
        shares = partial(self.volumes.along, within=within)
        return Stage(
            name,
            self.sampler,
            VirtualImage(profile, options.levels, self.voxel, shares),
            reach=0.5,
            n_depths=5,
            bending=options.smoothness,
            sliding=SLIDING,
            anchor=self.anchor,
            tolerance=patience * loosening * options.tolerance,
            cost_tolerance=patience_cost * loosening * COST_TOLERANCE,
            loss=options.loss,
            solver=options.solver,
            max_iterations=options.max_iterations,
            further=tuple(view.compared(options, widening=widening, within=within) for view in self.views),
        )

    @property
    def _patience(self) -> tuple[float, float]:
        """Factors for the tolerances of displacement and cost; 0 for the cost switches that rule off."""
        if self.options.stopping == "published":
            return 1.0, 0.0
        # Gradient descent takes many small steps, and must not stop at the first of them.
        return (1.0, 1.0) if self.options.solver == "gauss-newton" else (0.05, 0.05)


def frame_of(pose: Moments) -> np.ndarray:
    """Return the matrix (4, 4) from the frame of an organ's principal axes about its centre to RAS mm."""
    local_to_ras = np.eye(4)
    local_to_ras[:3, :3], local_to_ras[:3, 3] = pose.axes.T, pose.center
    return local_to_ras


def _as_to_start(options: FitOptions, pixel: float) -> FitOptions:
    """Fill in initial values of the automatic options; `pixel` is the finest voxel spacing, mm."""
    return options.filled_in(
        tau=options.tau or TAU_PIXELS * pixel,
        smoothness=SMOOTHNESS_TO_START if options.smoothness is None else options.smoothness,
        max_iterations=options.max_iterations or MAX_ITERATIONS[options.solver],
    )


# ------------------------------------------------------------------ parts of the image


def _local_crop(image: Image, region: Region, local_to_ras: np.ndarray, *, margin: float) -> Image:
    """Crop the image around the region, `margin` in mm, and move it to the organ's frame."""
    reach = np.ceil(margin / image.spacing[::-1]).astype(int) + 1
    start = np.maximum(np.asarray(region.offset) - reach, 0)
    stop = np.minimum(np.asarray(region.offset) + region.mask.shape + reach, image.array.shape)
    crop = image.crop(start, stop)
    return Image(crop.array, np.linalg.inv(local_to_ras) @ crop.ijk_to_ras)


# ------------------------------------------------------------------ checks


def _check_grid(image: Image, region: Region) -> None:
    """Raise an error if the region does not belong to the image."""
    first = image.to_ras(np.array([region.offset[::-1]], dtype=float))[0]
    # A region that was completed by further stacks may extend beyond the image.
    last = np.asarray(region.offset) + region.mask.shape
    fits = np.all(last > 0) and np.all(np.asarray(region.offset) < image.array.shape)
    same = np.allclose(first, region.ijk_to_ras[:3, 3], atol=1e-3) and np.allclose(
        image.ijk_to_ras[:3, :3], region.ijk_to_ras[:3, :3], atol=1e-5
    )
    if not (fits and same):
        msg = "The region does not lie on the image's grid; separate the organ in this image, or resample its mask."
        raise ValueError(msg)


def _check_tau(tau: float | None, pixel: float) -> None:
    """Raise an error if tau is much smaller than a voxel."""
    if tau is not None and tau < _LEAST_TAU * pixel:
        msg = (
            f"A tau of {tau:g} mm was given, and voxels are {pixel:.3g} mm: no image shows an edge as sharp. Give two "
            "to three voxels, or leave it to be chosen."
        )
        raise ValueError(msg)


def _check_thickness(pose: Moments, tau: float) -> None:
    """Raise an error if the organ is thinner than tau on each side."""
    # Half of the shortest axis of the ellipsoid with the region's moments.
    half_thickness = np.sqrt(5.0) * float(pose.extents.min())
    if half_thickness < tau:
        msg = (
            f"The region is about {2.0 * half_thickness:.2g} mm thick; an edge of {tau:.2g} mm is sought on "
            "each side. Check the region (threshold and erosion, or label), or take a finer image or a smaller tau."
        )
        raise ValueError(msg)
