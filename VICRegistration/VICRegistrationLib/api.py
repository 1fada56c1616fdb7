"""Functions of the public interface: fits that run to their end, a comparison, a surface from a file."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .geometry.surface import BSplineSurface
from .imaging.image import Image, as_image
from .imaging.region import Region
from .registration import organ
from .registration import refit as refitting
from .registration.options import FitOptions
from .registration.organ_fit import OrganFit
from .registration.stacks import Stack
from .registration.stages import Step
from .registration.steps import finish

if TYPE_CHECKING:
    from .analysis.comparison import Comparison
    from .multipatch.fit import ModelFit
    from .multipatch.joint import JointStep
    from .multipatch.model import MultiPatchModel


def fit(
    image: Image | str | os.PathLike,
    seeds: np.ndarray,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    further: Sequence[Stack | Image | str | os.PathLike] = (),
    on_step: Callable[[Step], None] | None = None,
    **choices,
) -> OrganFit:
    """Separate an organ and fit a surface to it.

    Parameters
    ----------
    image : Image or path
    seeds : (n, 3) array_like
        Points inside the organ, RAS mm.
    options : FitOptions, optional
    boundary_points : (n, 3) array_like, optional
        Points that the surface is to pass through, RAS mm.
    further : sequence of Stack, Image or path
        More stacks of the patient. The surface is fitted to all of them together, and the motion between them is
        estimated; how each was used is in `OrganFit.stacks`.
    on_step : callable, optional
        Called with every step of the fit: stage, iteration, cost, displacement, surface. To stop between two steps,
        iterate over :func:`.registration.organ.fit_organ` instead.
    **choices
        Single options of :class:`FitOptions`, such as ``net=(9, 7)``; they replace those of `options`.

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the image cannot be read, the organ cannot be separated, or a boundary point or an option cannot be used.

    References
    ----------
    .. [1] Z. Jiang et al.: Virtual image correlation of magnetic resonance images for 3D geometric modelling of pelvic
       organs. Strain 55(3):e12305, 2019. doi:10.1111/str.12305

    Examples
    --------
    A ball with a radius of 16 mm, in voxels of 2 mm:

    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> distance = 2.0 * np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> fit = vic.fit(image, [[23, 23, 23]], net=(9, 7))
    >>> fit.converged
    True
    >>> print(f"{fit.surface.volume() / 1000:.1f} ml")
    17.2 ml
    """
    options = _options(options, choices)
    steps = organ.fit_organ(image, seeds, options, boundary_points=boundary_points, further=further)
    return finish(steps, on_step)


def fit_region(
    image: Image | str | os.PathLike,
    region: Region,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    further: Sequence[Stack | Image | str | os.PathLike] = (),
    on_step: Callable[[Step], None] | None = None,
    **choices,
) -> OrganFit:
    """Fit a surface to a separated region and to the grey levels.

    Parameters
    ----------
    image : Image or path
    region : Region
        From :func:`separate` or :func:`region_from_mask`, on the image's grid.
    options, boundary_points, further, on_step, **choices
        As for :func:`fit`.

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the region is too thin for a surface or does not lie on the image's grid; and as in :func:`fit`.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> distance = 2.0 * np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> region = vic.region_from_mask(image, image.array > 50)
    >>> vic.fit_region(image, region, net=(9, 7)).options.net
    (9, 7)
    """
    image = as_image(image)
    if not isinstance(region, Region):
        msg = (
            f"A region is needed, and {type(region).__name__} was given; make one with separate, region_from_mask or "
            "region_from_label."
        )
        raise TypeError(msg)
    options = _options(options, choices)
    steps = organ.fit_region(image, region, options, boundary_points=boundary_points, further=further)
    return finish(steps, on_step)


def refit(
    image: Image | str | os.PathLike,
    surface: BSplineSurface | str | os.PathLike,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    region: Region | None = None,
    further: Sequence[Stack | Image | str | os.PathLike] = (),
    on_step: Callable[[Step], None] | None = None,
    **choices,
) -> OrganFit:
    """Fit a surface again: to the grey levels, or through points on the wall.

    Parameters
    ----------
    image : Image or path
    surface : BSplineSurface or path
        Surface of a closed organ, near the organ's edge in the image, RAS mm.
    options, boundary_points, further, on_step, **choices
        As for :func:`fit`; net and closure are those of the surface. With boundary points, the surface moves only
        around them.
    region : Region, optional
        Region that the surface was fitted to before; it is only passed to the result.

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the surface is no closed organ or lies outside of the volume; and as in :func:`fit`.

    Examples
    --------
    A point 3 mm beside the ball of :func:`fit` is reached:

    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> from VICRegistrationLib.geometry.projection import closest_points
    >>> distance = 2.0 * np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> fit = vic.fit(image, [[23, 23, 23]], net=(9, 7))
    >>> point = np.array([[23, 23, 42]])
    >>> corrected = vic.refit(image, fit.surface, boundary_points=point)
    >>> bool(abs(closest_points(corrected.surface, point).distances[0]) < 0.5)
    True
    """
    image = as_image(image)
    given = {"boundary_points": boundary_points, "region": region, "further": further}
    steps = refitting.refit(image, _as_surface(surface), _options(options, choices), **given)
    return finish(steps, on_step)


def fit_model(
    image: Image | str | os.PathLike,
    organs: Mapping[str, np.ndarray | Region],
    model: MultiPatchModel | str | os.PathLike = "pelvis",
    options: Mapping[str, FitOptions] | None = None,
    *,
    landmarks: Mapping[str, np.ndarray] | None = None,
    further: Sequence[Stack | Image | str | os.PathLike] | Mapping[str, Sequence] = (),
    on_step: Callable[[JointStep], None] | None = None,
) -> ModelFit:
    """Fit a generic model of several organs, and move the parts that the image does not show along with them.

    Parameters
    ----------
    image : Image or path
    organs : mapping of str to (n, 3) array_like or Region
        Points inside each organ, RAS mm, or its region, by the organs' names in the model: at least two. Organs of the
        model that are not given are predicted from the others.
    model : MultiPatchModel or path
        A model, its file, or the name of one that ships, see :func:`find_model`.
    options : mapping of str to FitOptions, optional
        Options of some or all organs; net, closure and generic model are those of the model.
    landmarks : mapping of str to (3,) array_like, optional
        Positions of landmarks of the model in the image, RAS mm.
    further : sequence of Stack, Image or path, or mapping of str to such sequences, optional
        More stacks of the patient, for all organs or for each; see :class:`Stack`.
    on_step : callable, optional
        Called with every step of the fit: stage, iteration, cost, displacement, surfaces. To stop between two steps,
        iterate over :func:`.multipatch.fit.fit_model` instead.

    Returns
    -------
    ModelFit

    Raises
    ------
    ValueError
        If an organ cannot be separated, organs, options or landmarks do not fit the model, or the image has another
        unit or frame.

    Examples
    --------
    A model of two balls, in an image of two others:

    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> from VICRegistrationLib.geometry.models import closed_organ
    >>> from VICRegistrationLib.multipatch.cuts import OrganCuts
    >>> from VICRegistrationLib.multipatch.drawing import Drawing
    >>> balls = {name: closed_organ((9, 7), axes=14 * np.eye(3), center=(r, 0, 0)) for name, r in (("a", 0), ("b", 42))}
    >>> cuts = {name: OrganCuts([0, 0.5], [0, 1], [[f"{name} front"], [f"{name} back"]]) for name in balls}
    >>> model = Drawing(balls, cuts).model(name="balls", landmarks={})
    >>> place = np.moveaxis(np.indices((24, 24, 48)), 0, -1)
    >>> distance = 2.0 * np.minimum(*(np.linalg.norm(place - (11.5, 11.5, i), axis=-1) for i in (11.5, 35.5)))
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> fit = vic.fit_model(image, {"a": [[23, 23, 23]], "b": [[71, 23, 23]]}, model)
    >>> [f"{parent.volume() / 1000.0:.1f} ml" for parent in fit.model.parents.values()]
    ['17.3 ml', '17.3 ml']
    >>> fit.predicted
    ()
    """
    from .multipatch.fit import fit_model as steps_of
    from .multipatch.library import find_model
    from .segmentation.separation import separate

    image, options = as_image(image), options or {}
    for what, given in (("organs", organs), ("options", options)):
        if not isinstance(given, Mapping):
            msg = f"{type(given).__name__} was given as {what}; a mapping is needed, with the organs' names as keys."
            raise TypeError(msg)
    if isinstance(model, (str, os.PathLike)):
        model = find_model(model)
    regions = {}
    for name, given in organs.items():
        asked = options.get(name, FitOptions())
        how = {"threshold": asked.threshold, "erosion": asked.erosion, "dilation": asked.dilation}
        regions[name] = given if isinstance(given, Region) else separate(image, given, **how)
    return finish(steps_of(image, model, regions, options, landmarks=landmarks, further=further), on_step)


def compare(
    surface: BSplineSurface | str | os.PathLike, reference, *, label: int | str | None = None, **choices
) -> Comparison:
    """Compare a surface with a reference: distances both ways, surface and volume Dice.

    Parameters
    ----------
    surface : BSplineSurface or path
        Closed, RAS mm.
    reference : BSplineSurface, ReferenceMesh or path
        Another surface, or a file with a surface, a mesh, or a label image on any grid.
    label : int or str, optional
        Value or name of the organ's label, for a file with several.
    **choices
        As for :func:`.analysis.comparison.compare`.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If surface or reference is open or has no volume, or the file holds no reference.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> from VICRegistrationLib.geometry.models import closed_organ
    >>> ball, larger = (closed_organ((9, 7), axes=radius * np.eye(3)) for radius in (16.0, 17.0))
    >>> found = vic.compare(larger, ball, n_points=1000)
    >>> print(f"{found.to_surface.mean:.1f} mm")
    1.0 mm
    """
    from .analysis.comparison import compare as compared
    from .analysis.reference_meshes import ReferenceMesh
    from .analysis.references import read_reference

    if isinstance(reference, (str, os.PathLike)):
        reference = read_reference(reference, label=label).reference
    elif not isinstance(reference, ReferenceMesh):
        reference = _as_surface(reference)
    return compared(_as_surface(surface), reference, **choices)


def read_surface(path: str | os.PathLike) -> BSplineSurface:
    """Read a surface that was saved with all of its control points.

    Parameters
    ----------
    path : path
        A .json or .vtp file.

    Returns
    -------
    BSplineSurface
        RAS mm.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it holds no surface.

    Examples
    --------
    >>> import numpy as np, os, tempfile
    >>> import VICRegistrationLib as vic
    >>> from VICRegistrationLib.geometry.models import closed_organ
    >>> ball = closed_organ((9, 7), axes=16.0 * np.eye(3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = os.path.join(folder, "ball.json")
    ...     ball.save(path)
    ...     again = vic.read_surface(path)
    >>> np.array_equal(again.control_net, ball.control_net)
    True
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".json", ".vtp"):
        msg = f"{path} holds no control points; those of a surface are in .json and .vtp files, as save writes them."
        raise ValueError(msg)
    if suffix == ".vtp":
        from .export.mesh_reading import read_vtp_record

        return read_vtp_record(path).surface
    from .geometry.surface_file import read_surface as read

    return read(path)


def _as_surface(surface: object) -> BSplineSurface:
    """Return a surface, or read it from its file."""
    if isinstance(surface, (str, os.PathLike)):
        return read_surface(surface)
    if not isinstance(surface, BSplineSurface):
        msg = (
            f"A surface is needed, and {type(surface).__name__} was given; give that of a fit, which is fit.surface, "
            "or the path of a file."
        )
        raise TypeError(msg)
    return surface


def _options(options: FitOptions | None, choices: dict) -> FitOptions:
    """Replace single options by choices."""
    known = [field.name for field in fields(FitOptions)]
    unknown = [name for name in choices if name not in known]
    if unknown:
        msg = f"There is no option {', '.join(unknown)}; the options are {', '.join(known)}."
        raise TypeError(msg)
    if not isinstance(options, (FitOptions, type(None))):
        msg = (
            f"Options are FitOptions, and {type(options).__name__} was given; give single ones by their names, such as "
            "net=(9, 7)."
        )
        raise TypeError(msg)
    return replace(options or FitOptions(), **choices)
