"""Fitting of smooth B-spline surfaces to organs in medical images by virtual image correlation.

>>> import VICRegistrationLib as vic

reads images (:func:`read_image`), separates organs (:func:`separate`), fits surfaces (:func:`fit`, :func:`fit_region`,
:func:`refit`), compares them (:func:`compare`) and writes them (:meth:`BSplineSurface.save`). Positions are RAS mm.

References
----------
.. [1] Z. Jiang, O. Mayeur, J.-F. Witz, P. Lecomte-Grosbras, J. Dequidt, M. Cosson, C. Duriez and M. Brieu: Virtual
   image correlation of magnetic resonance images for 3D geometric modelling of pelvic organs. Strain 55(3):e12305,
   2019. doi:10.1111/str.12305
"""

import importlib

__version__ = "0.1.0"

# Module of each public name. Modules are imported when a name is first used, because importing SciPy, SimpleITK and VTK
# takes long.
_MODULES = {
    "BSplineSurface": "geometry.surface",
    "FitOptions": "registration.options",
    "Image": "imaging.image",
    "MultiPatchModel": "multipatch.model",
    "OrganFit": "registration.organ_fit",
    "Region": "imaging.region",
    "Stack": "registration.stacks",
    "compare": "api",
    "find_model": "multipatch.library",
    "fit": "api",
    "fit_model": "api",
    "fit_region": "api",
    "read_image": "imaging.reading",
    "read_surface": "api",
    "refit": "api",
    "region_from_label": "imaging.region",
    "region_from_mask": "imaging.region",
    "separate": "segmentation.separation",
}
__all__ = sorted(_MODULES)  # noqa: PLE0605


def __getattr__(name):
    """Import a public name at its first use (PEP 562)."""
    if name not in _MODULES:
        msg = f"module '{__name__}' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(importlib.import_module(f".{_MODULES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__():
    """Return all names of the package, including those that are not imported yet."""
    return sorted({*globals(), *__all__})
