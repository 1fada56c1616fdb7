"""What a user should look at before trusting a region or a surface, in plain words."""

from __future__ import annotations

from ..imaging.boxes import ball_radius
from ..imaging.image import Image, patient_side
from ..imaging.region import Region
from .organ import OrganFit

# Mean squared difference between the image and an edge, over the squared contrast.
_POOR_COST = 0.5
# Of the area; less is drowned in noise.
_LEAST_WITHOUT_EDGE = 0.02
# Between the separated region and the surface; voxels at the surface alone make a few per cent.
_LARGEST_CHANGE = 0.2
# How far the region may reach beyond the surface, in radii of a ball of its volume. Seen: 0.1 where all is well.
_LARGEST_REACH = 0.2


def warnings_about(image: Image, fit: OrganFit) -> list[str]:
    """Sentences about a fit.

    Parameters
    ----------
    image : Image
        The image that was fitted.
    fit : OrganFit

    Returns
    -------
    list of str
        Empty if nothing is known to be wrong.
    """
    # The library's own remedies are for programmers.
    sentences = [
        f"{problem.message.partition('; ')[0]}; look at the contour, and try a smaller net or another seed, threshold "
        "or erosion."
        for problem in fit.problems
    ]
    if not fit.converged:
        last = next(step for step in reversed(fit.history) if step.stopped_by and not step.converged)
        why = (
            "because no further step lowered the cost"
            if last.stopped_by == "no better point"
            else f"while the surface still moved by {last.displacement:.2g} mm"
        )
        sentences.append(
            f"The fit stopped after {last.iteration} iterations of its stage {last.stage}, {why}; look at the contour."
        )
    region = [] if fit.region is None else warnings_about_region(image, fit.region)
    return [*sentences, *region, *_warnings_about_fit(fit)]


def warnings_about_region(image: Image, region: Region) -> list[str]:
    """Sentences about a separated region.

    Parameters
    ----------
    image : Image
        The image that holds the region.
    region : Region

    Returns
    -------
    list of str
    """
    sides = border_sides(image, region)
    border = [
        f"The organ reaches the border of the image ({', '.join(sides)}) and may go on outside of it; there the "
        "surface is not that of the organ."
    ]
    return [*(border if sides else []), *region.warnings]


def border_sides(image: Image, region: Region) -> list[str]:
    """Sides of the patient at which a region touches the border of its image.

    Parameters
    ----------
    image : Image
    region : Region

    Returns
    -------
    list of str
        Out of "left", "right", "posterior", "anterior", "inferior" and "superior".
    """
    return list(dict.fromkeys(_side(image, face) for face in region.touches_border))


def _side(image: Image, face: str) -> str:
    """Side of the patient that a face of the volume such as "k-" looks to."""
    axis, sign = "ijk".index(face[0]), -1.0 if face[1] == "-" else 1.0
    outward = sign * image.ijk_to_ras[:3, axis]
    return patient_side(outward)


def _warnings_about_fit(fit: OrganFit) -> list[str]:
    """Sentences about a surface that may be valid and yet not that of an organ."""
    sentences = []
    if fit.cost_final >= _POOR_COST:
        sentences.append(
            "The surface follows no clear edge: the grey levels beside it differ from an edge by more than half of "
            f"the contrast (cost {fit.cost_final:.2g}); look at the contour, and give another seed or threshold."
        )
    sentences += _warnings_about_support(fit)
    if fit.region is None:
        return sentences
    volume, separated = fit.surface.volume() / 1000.0, float(fit.region.volume_ml)
    if abs(volume - separated) > _LARGEST_CHANGE * separated:
        sentences.append(
            f"The surface holds {volume:.1f} ml, but the separated region {separated:.1f} ml; look at the contour, and "
            "give another threshold or erosion if the region is wrong, or place points on the wall if the surface is."
        )
    return [*sentences, *_warnings_about_reach(fit)]


def _warnings_about_reach(fit: OrganFit) -> list[str]:
    """Sentences about parts of the region that the surface leaves out: thin ones change the volume by little."""
    reach, side = fit.left_out
    if reach <= _LARGEST_REACH * ball_radius(fit.surface.volume()):
        return []
    return [
        f"The separated region reaches {reach:.0f} mm beyond the surface at its {side} side: a thin part of the organ "
        "that the surface does not follow, or a leak. Look at the contour there, and place points on the wall if the "
        "region is right, or give another threshold or erosion if it is not."
    ]


def _warnings_about_support(fit: OrganFit) -> list[str]:
    """Sentences about places where the image does not tell where the surface is."""
    confidence = fit.confidence
    if confidence.unsupported_share < _LEAST_WITHOUT_EDGE:
        return []
    side = confidence.unsupported_side
    where = f", mostly at its {side} side" if side else ""
    held = "" if fit.region is None else "; what holds it there is the separated region"
    return [
        f"The surface follows no edge on {confidence.unsupported_share:.0%} of its area{where}{held}. Look at the "
        "contour there, and place points on the wall where you know it."
    ]
