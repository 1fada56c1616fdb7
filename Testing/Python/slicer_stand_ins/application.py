"""Stand-ins of slicer.app, slicer.modules and the Sample Data module, as far as this module uses them."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import slicer


class Application:
    """What slicer.app offers when Slicer runs with --testing --no-main-window."""

    applicationName = "Slicer"
    majorVersion, minorVersion = 5, 8

    def __init__(self, mrml):
        self._mrml, self._manager, self._files = mrml, ModuleManager(), SceneFiles(mrml)
        self._handlers = {"startupCompleted()": []}
        self._clipboard = Clipboard()
        self.temporaryPath = str(mrml.temporary)
        self.eventLoop = None

    def connect(self, signal, handler):
        if signal not in self._handlers:
            msg = f"'Application' has no signal '{signal}'"
            raise AttributeError(msg)
        self._handlers[signal].append(handler)
        return True

    def startupCompleted(self):
        """Emit the signal: what is registered for the end of Slicer's start is run."""
        for handler in self._handlers["startupCompleted()"]:
            handler()

    def processEvents(self, *arguments):
        """Run what waits in the event loop of the widgets' stand-ins, if they are in use."""
        if self.eventLoop is not None:
            self.eventLoop.processEvents()

    def applicationLogic(self):
        return self._mrml.application

    def moduleManager(self):
        return self._manager

    def coreIOManager(self):
        return self._files

    def layoutManager(self):
        return None

    def testingEnabled(self):
        return True

    def translate(self, context, text):
        return text

    def clipboard(self):
        return self._clipboard

    def pauseRender(self):
        """There are no views to stop."""

    def resumeRender(self):
        """There are no views to start."""


class Clipboard:
    """Text that was copied."""

    def __init__(self):
        self._text = ""

    def setText(self, text):
        if not isinstance(text, str):
            msg = f"QClipboard.setText takes a text, not {text!r}"
            raise ValueError(msg)
        self._text = text

    def text(self):
        return self._text


class ModuleManager:
    """The modules there are, and the signal before one is unloaded."""

    def __init__(self):
        self._handlers = []

    def module(self, name):
        return vars(slicer.modules).get(name.lower())

    def connect(self, signal, handler):
        if signal != "moduleAboutToBeUnloaded(QString)":
            msg = f"'ModuleManager' has no signal '{signal}'"
            raise AttributeError(msg)
        self._handlers.append(handler)
        return True

    def disconnect(self, signal, handler):
        self._handlers.remove(handler)

    def unload(self, name):
        for handler in list(self._handlers):
            handler(name)


class SceneFiles:
    """What slicer.util.saveScene and loadScene ask of the application: .mrb files."""

    def __init__(self, mrml):
        self._scene = mrml.scene

    def saveNodes(self, fileType, properties, messages):
        self._check(fileType, properties)
        return bool(self._scene.WriteToMRB(properties["fileName"]))

    def loadNodes(self, fileType, properties, loaded, messages):
        self._check(fileType, properties)
        return bool(self._scene.ReadFromMRB(properties["fileName"], bool(properties.get("clear", False))))

    def _check(self, fileType, properties):
        if fileType != "SceneFile" or Path(properties["fileName"]).suffix != ".mrb":
            msg = f"The stand-in got {fileType} {properties['fileName']}; it can only save and load scenes as .mrb"
            raise NotImplementedError(msg)


class CoreModule:
    """A module of Slicer's own that has a logic."""

    def __init__(self, name, logic):
        self.name, self._logic = name, logic

    def logic(self):
        return self._logic


class SampleDataLogic:
    """Remembers the sample data that modules offer."""

    def __init__(self):
        self._sources = slicer.modules.sampleDataSources

    @staticmethod
    def registerCustomSampleDataSource(
        category="Custom",
        sampleName=None,
        uris=None,
        fileNames=None,
        nodeNames=None,
        customDownloader=None,
        thumbnailFileName=None,
        loadFileTypes=None,
        loadFiles=None,
        loadFileProperties=None,
        checksums=None,
        loadFileType=None,
    ):
        """Offer sample data; registering a name again in its category replaces it."""
        given = {name: value for name, value in locals().items() if name != "category"}
        if uris is None:
            msg = "'NoneType' object is not iterable: uris must be given"
            raise TypeError(msg)
        sources = slicer.modules.sampleDataSources.setdefault(category, [])
        sources[:] = [source for source in sources if source.sampleName != sampleName]
        sources.append(SimpleNamespace(**given))

    def sourceForSampleName(self, sampleName):
        sources = (source for sources in self._sources.values() for source in sources)
        return next((source for source in sources if source.sampleName == sampleName), None)


class ScriptedModule:
    """A scripted module that was found in a file, as in slicer.modules."""

    def __init__(self, name, path):
        self.name, self.path, self._widget = name, str(path), None

    def widgetRepresentation(self):
        """The module's widget, made and set up when it is first asked for."""
        if self._widget is None:
            import qt

            self._widget = slicer.qSlicerScriptedLoadableModuleWidget()
            self._widget._make = lambda parent: getattr(sys.modules[self.name], f"{self.name}Widget")(parent)
            self._widget.setLayout(qt.QVBoxLayout())
            self._widget.setMRMLScene(slicer.mrmlScene)
            self._widget.reload()
        return self._widget

    def unload(self):
        """Let the widget clean up, as on reload and at the end of Slicer."""
        slicer.app.moduleManager().unload(self.name)
        if self._widget is not None:
            self._widget.deleteLater()
        self._widget = None
        vars(slicer.modules).pop(f"{self.name}Widget", None)


class ModuleParent:
    """What a module's constructor fills in."""

    __slots__ = (
        "title",
        "categories",
        "dependencies",
        "contributors",
        "helpText",
        "acknowledgementText",
        "icon",
        "hidden",
        "index",
        "path",
        "associatedNodeTypes",
        "widgetRepresentationCreationEnabled",
    )

    def __init__(self, path):
        self.path = str(path)
