"""Pictures of a report. Needs matplotlib."""

from __future__ import annotations

from ..analysis.distances import Reference
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image
from ..organ_colours import organ_colours
from ..registration.organ import OrganFit
from .canvas import blank_figure, drawn_pixels, indexed_png
from .confidence_picture import area_percentiles, confidence_map
from .contents import Compared, OrganFigures
from .deviation_picture import deviation_map
from .panels import draw_convergence, draw_scene, draw_slices, fine_mesh
from .pictures import VIEWERS, shown_organ

# The other sides, so that together with the usual view all of the surface is seen.
_OTHER_SIDE = (0.80, -0.52, 0.30)
_PERCENTS = (50.0, 90.0, 95.0, 100.0)


def organ_figures(
    image: Image, fit: OrganFit, name: str, *, reference: Reference | None = None, compared: Compared | None = None
) -> OrganFigures:
    """Draw everything about one organ.

    Parameters
    ----------
    image : Image
        The grey levels that were fitted.
    fit : OrganFit
    name : str
        Decides the colour.
    reference : BSplineSurface, TriangleMesh or ReferenceMesh, optional
        Its contour is drawn in the slices.
    compared : Compared, optional
        Gives the picture of the deviation.

    Returns
    -------
    OrganFigures

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    surfaces, contours = shown_organ(fit, organ_colours([name])[name], reference)
    slices = blank_figure((11.0, 3.58))
    region = None if fit.region is None else fit.region.image
    draw_slices(slices, (0.015, 0.97), image, surfaces, contours, region=region)
    sides = blank_figure((11.0, 3.6))
    for number, viewer in enumerate((VIEWERS[0], _OTHER_SIDE)):
        draw_scene(sides.add_axes((0.02 + 0.49 * number, 0.01, 0.47, 0.98)), surfaces, viewer)
    convergence = blank_figure((11.0, 3.3))
    draw_convergence(convergence.add_axes((0.08, 0.16, 0.90, 0.73)), fit)
    deviations = confidence_map(*_with_deviations(surfaces[0].mesh, fit.confidence))
    distances = None if compared is None else deviation_map(compared.mesh, compared.distances, compared.comparison)
    figures = (slices, sides, convergence, deviations, distances)
    return OrganFigures(*(None if figure is None else indexed_png(drawn_pixels(figure)) for figure in figures))


def confidence_percentiles(fit: OrganFit) -> list[tuple[float, float]]:
    """Measure the standard deviations that shares of the area stay below.

    Parameters
    ----------
    fit : OrganFit

    Returns
    -------
    list of (percent, mm)
    """
    mesh, deviations = _with_deviations(fine_mesh(fit.surface), fit.confidence)
    return list(zip(_PERCENTS, area_percentiles(mesh, deviations, _PERCENTS)))


def _with_deviations(mesh: TriangleMesh, confidence):
    """Triangles with the standard deviation (n,) of their vertices, mm."""
    return mesh, confidence.standard_deviation(mesh.parameters)
