"""Puts the stand-ins in place, so that a module of Slicer can be imported and run in a plain Python."""

from __future__ import annotations

import functools
import importlib
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import mrml_boot


@functools.cache
def install():
    """Boot MRML, and give Python the modules slicer.i18n, qt and so on; done once per process.

    Returns
    -------
    mrml_boot.Mrml
    """
    mrml = mrml_boot.boot()
    import slicer

    from . import annotations, application, scripted, wrapper

    _forgetUtilities(slicer)
    slicer.app = application.Application(mrml)
    modules = {name: application.CoreModule(name, logic) for name, logic in mrml.logics.items()}
    slicer.modules = SimpleNamespace(sampleDataSources={}, **modules)
    _module("slicer.i18n", tr=scripted.tr, translate=scripted.translate, getContext=scripted.getContext)
    bases = [cls for name, cls in vars(scripted).items() if name.startswith("ScriptedLoadableModule")]
    _module("slicer.ScriptedLoadableModule", **{cls.__name__: cls for cls in bases})
    names = ("Default", "FloatRange", "WithinRange", "RangeBounds")
    _module(
        "slicer.parameterNodeWrapper",
        **{name: getattr(annotations, name) for name in names},
        parameterNodeWrapper=wrapper.parameterNodeWrapper,
    )
    _module("SampleData", SampleDataLogic=application.SampleDataLogic)
    # Empty, so that using a widget fails; recorded_widgets fills them.
    _module("qt")
    _module("ctk")
    return mrml


def loadModule(path):
    """Load a scripted module as Slicer does when it starts.

    Parameters
    ----------
    path : path-like
        The module's file; its name is that of the module.

    Returns
    -------
    application.ScriptedModule
        Also to be found as ``slicer.modules.<name in lower case>``.
    """
    install()
    import slicer

    from .application import ModuleParent, ScriptedModule

    path = Path(path).resolve()
    name = path.stem
    if name.lower() in vars(slicer.modules):
        return getattr(slicer.modules, name.lower())
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    python = sys.modules.get(name) or importlib.import_module(name)
    module = ScriptedModule(name, path)
    setattr(slicer.modules, name.lower(), module)
    setattr(slicer.modules, f"{name}Instance", getattr(python, name)(ModuleParent(path)))
    return module


def _module(name, **members):
    module = ModuleType(name, "A stand-in; what is not in it, is not used by this project.")
    vars(module).update(members)
    sys.modules[name] = module
    parent, _, last = name.rpartition(".")
    if parent:
        setattr(sys.modules[parent], last, module)
    return module


def _forgetUtilities(slicer):
    """Take away what slicer-core has under slicer, but Slicer only under slicer.util."""
    for name in slicer.util.__all__:
        vars(slicer).pop(name, None)
