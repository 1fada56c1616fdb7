"""The plan by which an organ is registered: its generic model, its degrees of freedom, its stages."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.boxes import ball_radius
from ..imaging.image import Image
from ..imaging.region import Region
from ..imaging.sampling import Sampler
from ..messages import Diagnostic
from .drift_limit import astray
from .options import MOST_TAU_PIXELS, FitOptions
from .region_image import RegionImage, region_image
from .stages import Stage
from .virtual_image import INSIDE_PROBES, OUTSIDE_PROBES, PROBE_DEPTHS, IntensityProfile, VirtualImage

# Surroundings of the region that the model may start in, mm.
REGION_MARGIN_MM = 10.0
# Weights against sliding within the surface and against leaving the separated region, where 1 is about the weight of a
# sharp edge: tried 0.01 to 0.2 on phantoms and real bladders. More keeps the surface from its edge, less lets control
# points drift and loses the surface where there is no edge.
SLIDING = 0.02
ANCHOR = 0.05
# The region is fitted as stiffly as its voxels are coarse beside the organ: the weight of the thin-plate energy where a
# voxel is as large as the organ. Tried 0.08 to 0.5 on phantoms in slices of 4 mm and real bladders in slices of 1 mm:
# less lets the terraces, more cuts the organ's corners.
REGION_BENDING = 0.3
# A stage that lowers its cost by less than this fraction in an iteration only slides: the last stage, and those on the
# region, which the grey levels will correct anyway.
COST_TOLERANCE = 3e-3
REGION_COST_TOLERANCE = 2e-2
# Largest displacement of a control point at which the surface has come to its boundary points, mm.
BOUNDARY_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Plan:
    """What the stages of one organ are made of, in the organ's frame.

    Parameters
    ----------
    target : RegionImage
        The separated region.
    sampler : Sampler
        The grey levels around it.
    inside, outside : float
        Typical grey levels on both sides of the region's boundary.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.
    """

    target: RegionImage
    sampler: Sampler
    inside: float
    outside: float
    voxel: np.ndarray

    @classmethod
    def of(cls, image: Image, region: Region, local_to_ras: np.ndarray, options: FitOptions) -> Plan:
        """Look at an organ.

        Parameters
        ----------
        image : Image
        region : Region
        local_to_ras : (4, 4) ndarray
            Rigid frame of the organ.
        options : FitOptions

        Returns
        -------
        Plan

        Raises
        ------
        ValueError
            If the region is too thin, or has no surroundings.
        """
        widest = options.tau or MOST_TAU_PIXELS * float(min(image.spacing))
        target = region_image(region, local_to_ras, margin=REGION_MARGIN_MM)
        sampler = Sampler(_local_crop(image, region, local_to_ras, margin=4.0 * widest))
        inside, outside = _starting_levels(target, sampler, widest, options)
        voxel = np.linalg.inv(local_to_ras[:3, :3]) @ image.ijk_to_ras[:3, :3]
        return cls(target, sampler, inside, outside, voxel)

    def astray(self, surface: BSplineSurface) -> Diagnostic | None:
        """Tell why a surface has left the region or is no solid, if so; see :func:`.drift_limit.astray`."""
        return astray(surface, Sampler(self.target.distance), self.target.volume)

    @property
    def pixel(self) -> float:
        """Finest voxel spacing, mm."""
        return float(np.linalg.norm(self.voxel, axis=0).min())

    @property
    def _coarseness(self) -> float:
        """Mean square of a voxel's edges in units of the squared radius of a ball of the region's volume."""
        return float(np.mean(np.sum(self.voxel**2, axis=0))) / ball_radius(self.target.volume) ** 2

    def region_stages(self, options: FitOptions) -> tuple[Stage, Stage]:
        """Plan the stages on the region: global scaling, and local registration."""
        patience, patience_cost = _patience(options)
        target = self.target
        profile = IntensityProfile(-target.extent, target.extent, 2.0 * target.extent, ramp="linear")
        far = {
            "sampler": Sampler(target.distance),
            "virtual": VirtualImage(profile, mode="given"),
            "n_depths": 3,
            "cost_tolerance": patience_cost * REGION_COST_TOLERANCE,
            "sliding": SLIDING,
            "solver": options.solver,
            "max_iterations": options.max_iterations,
        }
        scaling = Stage("global scaling", stop_rule="parameters", reach=0.15, **far)
        tolerance = patience * 3.0 * options.tolerance
        bending = 0.0 if options.smoothness == 0.0 else REGION_BENDING * self._coarseness
        return scaling, Stage("region", reach=0.02, bending=bending, tolerance=tolerance, **far)

    def grey_level_stages(self, options: FitOptions, *, anchor: float | None = None) -> tuple[Stage, Stage]:
        """Plan the stages on the grey levels, coarse and fine, for options with `tau` and `smoothness`."""
        return grey_level_stages(self.sampler, self.inside, self.outside, self.voxel, options, anchor=anchor)


def grey_level_stages(
    sampler: Sampler,
    inside: float,
    outside: float,
    voxel: np.ndarray,
    options: FitOptions,
    *,
    anchor: float | None = None,
) -> tuple[Stage, Stage]:
    """Plan the stages on the grey levels, coarse and fine.

    Parameters
    ----------
    sampler : Sampler
        The grey levels around the organ, in the frame of the surface.
    inside, outside : float
        Levels to start with.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel in that frame, mm.
    options : FitOptions
        With automatic choices filled in.
    anchor : float, optional
        Weight against leaving the surface that a stage begins with; a usual one if not given.

    Returns
    -------
    two Stage
    """
    patience, patience_cost = _patience(options)
    coarse, fine = (
        Stage(
            name,
            sampler,
            VirtualImage(
                IntensityProfile(inside, outside, widening * options.tau, centered=options.profile == "centered"),
                mode=options.levels,
                voxel=voxel,
            ),
            reach=0.5,
            n_depths=5,
            bending=options.smoothness,
            sliding=SLIDING,
            anchor=ANCHOR if anchor is None else anchor,
            tolerance=patience * loosening * options.tolerance,
            cost_tolerance=patience_cost * loosening * COST_TOLERANCE,
            loss=options.loss,
            solver=options.solver,
            max_iterations=options.max_iterations,
        )
        for name, widening, loosening in (("grey levels, coarse", 1.5, 3.0), ("grey levels, fine", 1.0, 1.0))
    )
    return coarse, fine


def voxels_along(surface: BSplineSurface, width: float, voxel: np.ndarray) -> float:
    """Tell how many voxels, with edges (3, 3), lie in a band around a surface, `width` in mm: what is seen there."""
    return surface.area() * width / abs(float(np.linalg.det(voxel)))


def surface_stages(
    image: Image,
    surface: BSplineSurface,
    points: np.ndarray,
    options: FitOptions,
    *,
    anchor: float | None = None,
) -> tuple[Stage, Stage, Stage]:
    """Plan the stages for a surface that is there already: grey levels, coarse and fine, and boundary points.

    Parameters
    ----------
    image : Image
    surface : BSplineSurface
        RAS mm.
    points : (n, 3) ndarray
        Boundary points, RAS mm.
    options : FitOptions
        With automatic choices filled in.
    anchor : float, optional
        As in :func:`grey_level_stages`.

    Returns
    -------
    three Stage

    Raises
    ------
    ValueError
        If the surface lies outside of the volume.
    """
    sampler = Sampler(
        crop_around(image, np.concatenate([surface.control_net.reshape(-1, 3), points]), 4.0 * options.tau)
    )
    inside, outside = levels_beside(surface, sampler, options)
    coarse, fine = grey_level_stages(sampler, inside, outside, image.ijk_to_ras[:3, :3], options, anchor=anchor)
    rules = {"solver": "gauss-newton", "tolerance": BOUNDARY_TOLERANCE, "cost_tolerance": 0.0}
    return coarse, fine, replace(fine, name="boundary points", **rules)


def crop_around(image: Image, points: np.ndarray, margin: float) -> Image:
    """Cut out the image around points, (n, 3) RAS mm."""
    reach = margin / image.spacing
    ijk = image.to_ijk(points)
    start = np.clip(np.floor(ijk.min(axis=0) - reach), 0, image.size - 2).astype(int)
    stop = np.clip(np.ceil(ijk.max(axis=0) + reach) + 1, start + 2, image.size).astype(int)
    return image.crop(start[::-1], stop[::-1])


def levels_beside(surface: BSplineSurface, sampler: Sampler, options: FitOptions) -> tuple[float, float]:
    """Find typical grey levels just inside and just outside of a surface; given levels where the user gave them.

    Parameters
    ----------
    surface : BSplineSurface
    sampler : Sampler
        The grey levels, in the surface's frame.
    options : FitOptions
        With `tau`.

    Returns
    -------
    inside, outside : float
        Medians; equal where the image shows no difference.

    Raises
    ------
    ValueError
        If the surface lies outside of the volume.
    """
    if options.levels == "given":
        return options.inside, options.outside
    u, v = surface.midpoints(24, 16)
    points, normals = surface.points(u, v), surface.normals(u, v)
    medians = []
    for depths in (PROBE_DEPTHS[INSIDE_PROBES], PROBE_DEPTHS[OUTSIDE_PROBES]):
        values, valid = sampler.values(points[:, None] + options.tau * depths[:, None] * normals[:, None])
        if not valid.any():
            msg = "The surface lies outside of the volume; choose the volume that it was fitted in."
            raise ValueError(msg)
        medians.append(float(np.median(values[valid])))
    return medians[0], medians[1]


def _patience(options: FitOptions) -> tuple[float, float]:
    """Factors for the tolerances of displacement and cost; with 0 the cost does not stop a stage."""
    if options.stopping == "published":
        return 1.0, 0.0
    # Gradient descent takes many small steps and may not stop at the first small one.
    return (1.0, 1.0) if options.solver == "gauss-newton" else (0.05, 0.05)


def _local_crop(image: Image, region: Region, local_to_ras: np.ndarray, *, margin: float) -> Image:
    """Cut out the image around the region, in the organ's frame."""
    reach = np.ceil(margin / image.spacing[::-1]).astype(int) + 1
    start = np.maximum(np.asarray(region.offset) - reach, 0)
    stop = np.minimum(np.asarray(region.offset) + region.mask.shape + reach, image.array.shape)
    crop = image.crop(start, stop)
    return Image(crop.array, np.linalg.inv(local_to_ras) @ crop.ijk_to_ras)


def _starting_levels(target: RegionImage, sampler: Sampler, reach: float, options: FitOptions) -> tuple[float, float]:
    """Find typical grey levels inside the region and just outside of it; given levels where the user gave them."""
    distance = target.distance
    k, j, i = np.nonzero(np.abs(distance.array) <= 4.0 * reach)
    values, valid = sampler.values(distance.to_ras(np.column_stack([i, j, k])))
    away = distance.array[k, j, i]
    inside = values[valid & (away < 0.0)]
    outside = values[valid & (away > 0.0)]
    if not len(inside) or not len(outside):
        msg = "The region fills the volume up to its border; a surface needs surroundings to be seen against."
        raise ValueError(msg)
    given = options.levels == "given"
    return (
        options.inside if given else float(np.median(inside)),
        options.outside if given else float(np.median(outside)),
    )
