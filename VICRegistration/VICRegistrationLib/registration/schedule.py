"""The schedule of an organ's fit: the images it is compared with, and the stages that are run on them, far to near."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.boxes import ball_radius
from ..imaging.image import Image
from ..imaging.moments import Moments
from ..imaging.region import Region
from ..imaging.sampling import Sampler
from .levels import levels_of_region, measured_levels
from .options import MAX_ITERATIONS, MOST_TAU_PIXELS, TAU_PIXELS, FitOptions
from .partial_volumes import PartialVolumes
from .region_image import RegionImage, region_image
from .stack_view import View
from .stages import Stage
from .virtual_image import IntensityProfile, VirtualImage

# Surroundings of the region that the model may start in, mm. Half and twice of it change the mean distances of the
# demo's organs and of four real bladders by 0.014 mm at most: the grid of the region's distances changes with it.
REGION_MARGIN_MM = 10.0
# Weights against sliding within the surface and against leaving the separated region, where 1 is about the weight of a
# sharp edge: tried 0.01 to 0.2 on phantoms and real bladders. More keeps the surface from its edge, less lets control
# points drift and loses the surface where there is no edge. Without this anchor no first fit changes; of two bladders
# that are fitted again from 1.6 mm beside one is off by 0.88 in place of 0.72 mm, one by 0.69 in place of 0.76 mm.
SLIDING = 0.02
ANCHOR = 0.05
# The region is fitted as stiffly as its voxels are coarse beside the organ: the weight of the thin-plate energy where a
# voxel is as large as the organ. Tried 0.08 to 0.5 on phantoms in slices of 4 mm and real bladders in slices of 1 mm:
# less lets the terraces, more cuts the organ's corners.
REGION_BENDING = 0.3
# A stage that lowers its cost by less than this fraction in an iteration only slides: the last stage, and those on the
# region, which the grey levels will correct anyway. Half and twice of both change these distances by 0.008 mm at most.
# Twice of the first saves 11 % of the iterations, but one of three hippocampi loses its finer net by it.
COST_TOLERANCE = 3e-3
REGION_COST_TOLERANCE = 2e-2
# Largest displacement of a control point at which the surface has come to its boundary points, mm.
BOUNDARY_TOLERANCE = 0.02
# Smoothness before the noise is known. Half and twice of it change these distances by 0.002 mm at most.
SMOOTHNESS_TO_START = 1e-5
# Within how many pixels of a surface partial volumes of another one are taken, on the grey levels, coarse and fine.
# Half and twice of the first change no mean distance of the demo and of three real bladders. The second has no plateau
# upward: half of it changes none by more than 0.002 mm, but with twice the demo's rectum is off by 0.08 in place of
# 0.06 mm, as the finest net is refused by partial volumes of the coarser one. With 0, nets follow noise: the surface
# that is judged has then partial volumes of its own noise, and a smooth organ of poor contrast gets the finest net.
_NEAR_COARSE, _NEAR_FINE = 4.0, 0.125
# How much wider than the edge the coarse stage's ramp is. If it is as wide, surfaces that begin 2.5 mm within the
# demo's bladder and rectum end 0.7 and 0.9 mm off, in place of 0.04 and 0.07.
_COARSE_WIDENING = 1.5
# Least width of an edge that is looked for, in voxels.
_LEAST_TAU = 0.1


@dataclass(frozen=True, eq=False)
class Schedule:
    """What the stages of one organ are made of.

    Parameters
    ----------
    sampler : Sampler
        The grey levels around the organ, in the frame in which it is fitted.
    volumes : PartialVolumes
        In its voxels.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel in that frame, mm.
    inside, outside : float
        Typical grey levels on both sides of the organ's boundary.
    options : FitOptions
        With `tau`, `smoothness` and `max_iterations`; those that are not chosen yet are as to start with.
    region : RegionImage, optional
        The separated region; None for a surface that is there already.
    anchor : float
        Weight against leaving the surface that a stage on the grey levels begins with.
    views : tuple of View
        Further images of the organ.
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
        """Plan the fit of a separated region, in the frame of its principal axes.

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
            If the region does not lie on the image's grid, is thinner than the edge that is looked for or has no
            surroundings, or the edge is sharper than any image.
        """
        _check_grid(image, region)
        pixel = float(min(image.spacing))
        _check_tau(options.tau, pixel)
        _check_thickness(pose, options.tau or TAU_PIXELS * pixel)
        local_to_ras = frame_of(pose)
        target = region_image(region, local_to_ras, margin=REGION_MARGIN_MM)
        widest = options.tau or MOST_TAU_PIXELS * pixel
        sampler = Sampler(_local_crop(image, region, local_to_ras, margin=4.0 * widest))
        levels = levels_of_region(target, sampler, widest, options)
        voxel = np.linalg.inv(local_to_ras[:3, :3]) @ image.ijk_to_ras[:3, :3]
        return cls(sampler, PartialVolumes(sampler.image), voxel, *levels, _as_to_start(options, pixel), target)

    @classmethod
    def around(
        cls, image: Image, surface: BSplineSurface, options: FitOptions, *, points: np.ndarray | None = None
    ) -> Schedule:
        """Plan the fit of a surface that is there already.

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
        """Take options, and perhaps an anchor, in place of those so far."""
        anchor = self.anchor if anchor is None else anchor
        return replace(self, options=self.options.filled_in(**options), anchor=anchor)

    def without_partial_volumes(self) -> Schedule:
        """Leave out the partial volumes that were computed so far: they are computed again."""
        return replace(self, volumes=PartialVolumes(self.sampler.image))

    def closer(self, factor: float) -> Schedule:
        """Hold the surface so many times closer to where a stage begins, and smoother."""
        return self.chosen(smoothness=factor * self.options.smoothness, anchor=factor * self.anchor)

    @property
    def pixel(self) -> float:
        """Finest voxel spacing, mm."""
        return float(np.linalg.norm(self.voxel, axis=0).min())

    def voxels_along(self, surface: BSplineSurface) -> float:
        """Count the voxels that lie in a band around a surface, as wide as its edge: what is seen there."""
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
        return Stage("region", reach=0.02, bending=bending, tolerance=tolerance, **self._on_region)

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
    def _on_region(self) -> dict:
        """What both stages on the region have in common."""
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
            How much wider than the edge the ramp is, and how much looser than asked for the tolerances.
        near : float
            Partial volumes of surfaces within so many pixels are taken.
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
        """Factors for the tolerances of displacement and cost; with 0 the cost does not stop a stage."""
        if self.options.stopping == "published":
            return 1.0, 0.0
        # Gradient descent takes many small steps and may not stop at the first small one.
        return (1.0, 1.0) if self.options.solver == "gauss-newton" else (0.05, 0.05)


def frame_of(pose: Moments) -> np.ndarray:
    """Frame of an organ's principal axes about its centre, (4, 4) to RAS mm."""
    local_to_ras = np.eye(4)
    local_to_ras[:3, :3], local_to_ras[:3, 3] = pose.axes.T, pose.center
    return local_to_ras


def _as_to_start(options: FitOptions, pixel: float) -> FitOptions:
    """Fill in what is not known before anything was seen; `pixel` is the finest voxel spacing, mm."""
    return options.filled_in(
        tau=options.tau or TAU_PIXELS * pixel,
        smoothness=SMOOTHNESS_TO_START if options.smoothness is None else options.smoothness,
        max_iterations=options.max_iterations or MAX_ITERATIONS[options.solver],
    )


# ------------------------------------------------------------------ parts of the image


def _local_crop(image: Image, region: Region, local_to_ras: np.ndarray, *, margin: float) -> Image:
    """Cut out the image around the region, in the organ's frame."""
    reach = np.ceil(margin / image.spacing[::-1]).astype(int) + 1
    start = np.maximum(np.asarray(region.offset) - reach, 0)
    stop = np.minimum(np.asarray(region.offset) + region.mask.shape + reach, image.array.shape)
    crop = image.crop(start, stop)
    return Image(crop.array, np.linalg.inv(local_to_ras) @ crop.ijk_to_ras)


# ------------------------------------------------------------------ what cannot be fitted


def _check_grid(image: Image, region: Region) -> None:
    """Refuse a region that was cut from another image."""
    first = image.to_ras(np.array([region.offset[::-1]], dtype=float))[0]
    # A region may go on beyond the image, where further stacks show the organ.
    last = np.asarray(region.offset) + region.mask.shape
    fits = np.all(last > 0) and np.all(np.asarray(region.offset) < image.array.shape)
    same = np.allclose(first, region.ijk_to_ras[:3, 3], atol=1e-3) and np.allclose(
        image.ijk_to_ras[:3, :3], region.ijk_to_ras[:3, :3], atol=1e-5
    )
    if not (fits and same):
        msg = "The region does not lie on the image's grid; separate the organ in this image, or resample its mask."
        raise ValueError(msg)


def _check_tau(tau: float | None, pixel: float) -> None:
    """Refuse an edge that is much sharper than any image."""
    if tau is not None and tau < _LEAST_TAU * pixel:
        msg = (
            f"A tau of {tau:g} mm was given, and voxels are {pixel:.3g} mm: no image shows an edge as sharp. Give two "
            "to three voxels, or leave it to be chosen."
        )
        raise ValueError(msg)


def _check_thickness(pose: Moments, tau: float) -> None:
    """Refuse an organ thinner than the edge that is looked for."""
    # Half of the shortest axis of the ellipsoid with the region's moments.
    half_thickness = np.sqrt(5.0) * float(pose.extents.min())
    if half_thickness < tau:
        msg = (
            f"The region is about {2.0 * half_thickness:.2g} mm thick; an edge of {tau:.2g} mm is sought on "
            "each side. Check the region (threshold and erosion, or label), or take a finer image or a smaller tau."
        )
        raise ValueError(msg)
