"""Fills the modules qt, ctk and slicer with the stand-ins."""

from __future__ import annotations

import functools
import sys
from types import SimpleNamespace

from . import base, event_loop, record


@functools.cache
def install():
    """Give Python the modules qt and ctk, and slicer its widgets; done once per process.

    Returns
    -------
    SimpleNamespace
        ``load_ui(path)``, ``loop`` and ``classes``.
    """
    from slicer_stand_ins.install import install as installSlicer

    installSlicer()
    import slicer

    from . import ctk_widgets, processes, scene_widgets, sliders, tables, ui_loader, value_types, widgets

    classes = {}
    for module in (widgets, sliders, tables, value_types, ctk_widgets, processes, scene_widgets):
        members = {name: cls for name, cls in vars(module).items() if isinstance(cls, base.RecordedType)}
        classes.update({name: cls for name, cls in members.items() if name in record.load()})
    for name, entry in record.load().items():
        # Those without behaviour of their own are strict all the same.
        if name not in classes:
            parent = widgets.QWidget if "setLayout" in entry.members else base.Recorded
            classes[name] = base.RecordedType(name, (parent,), {})
    for name, cls in classes.items():
        setattr(sys.modules[record.load()[name].module], name, cls)
    for cls in (value_types.Qt, value_types.QApplication):
        setattr(sys.modules["qt"], cls.__name__, cls)
    slicer.app.eventLoop = event_loop.LOOP
    loader = lambda path: ui_loader.Loader(classes).load(path)  # noqa: E731
    slicer.util.loadUI = loader
    return SimpleNamespace(load_ui=loader, loop=event_loop.LOOP, classes=classes)
