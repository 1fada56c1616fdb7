"""The organs of a scene, each with a hidden parameter node of its own."""

from __future__ import annotations

import contextlib

import slicer

from ..organ_colours import ORGAN_COLOURS, OTHER_COLOURS, rgb
from .colors import updateLegends
from .organ_nodes import nodesOf, paint, removeNodes, removeSegment
from .parameters import OrganParameters, forgetUnknownChoices
from .regions import TYPE_ATTRIBUTE

# Names and colours that the panel offers; other organs take the next free colour.
PRESETS = {name: rgb(color) for name, color in ORGAN_COLOURS.items()}
_OTHER_COLORS = tuple(map(rgb, OTHER_COLOURS))
_ORGAN = "organ"


class Organs:
    """The list of organs in the module's parameter node.

    Parameters
    ----------
    parameters : ModuleParameters

    Notes
    -----
    Every organ is one hidden vtkMRMLScriptedModuleNode; nodes that were removed from the scene are skipped.
    """

    def __init__(self, parameters):
        self.parameters = parameters
        self._wrappers = {}

    def __iter__(self):
        """Organs in the order of the table."""
        return iter([self.of(node) for node in self.nodes()])

    def __len__(self):
        """Count the organs."""
        return len(self.nodes())

    def nodes(self):
        """Parameter nodes of the organs that are still in the scene.

        Returns
        -------
        list of vtkMRMLScriptedModuleNode
        """
        return [node for node in self.parameters.organs if node is not None and node.GetScene() is not None]

    def of(self, node):
        """Organ of a parameter node; always the same object.

        Parameters
        ----------
        node : vtkMRMLScriptedModuleNode

        Returns
        -------
        OrganParameters
        """
        kept = self._wrappers.get(node.GetID())
        if kept is None or kept.parameterNode is not node:
            forgetUnknownChoices(node)
            kept = self._wrappers[node.GetID()] = OrganParameters(node)
        return kept

    def current(self):
        """Organ that is selected in the table, or None.

        Returns
        -------
        OrganParameters or None
        """
        node = self.parameters.current
        return self.of(node) if node is not None and node.GetScene() is not None else None

    def add(self, name):
        """Add an organ and make it the current one.

        Parameters
        ----------
        name : str
            A number is appended if an organ has this name already; "&" becomes "+". The colour is the usual one of
            an organ of this name, or one that is not used yet.

        Returns
        -------
        OrganParameters
        """
        node = slicer.mrmlScene.CreateNodeByClass("vtkMRMLScriptedModuleNode")
        node.UnRegister(None)
        node.SetModuleName("VICRegistration")
        node.SetAttribute(TYPE_ATTRIBUTE, _ORGAN)
        node.SetHideFromEditors(True)
        label = self._unusedName(name)
        node.SetName(slicer.mrmlScene.GenerateUniqueName(f"VIC {label}"))
        slicer.mrmlScene.AddNode(node)
        organ = self.of(node)
        organ.label = label
        organ.color = self._unusedColor(name)
        self.parameters.organs = [*self.nodes(), node]
        self.parameters.current = node
        return organ

    @contextlib.contextmanager
    def adding(self, name):
        """Add an organ, and remove it again if the work on it fails.

        Parameters
        ----------
        name : str

        Yields
        ------
        OrganParameters
            Removed with all its nodes if an exception leaves the context.
        """
        volume, current = self.parameters.volume, self.parameters.current
        organ = self.add(name)
        try:
            yield organ
        except BaseException:
            self.remove(organ)
            self.parameters.volume, self.parameters.current = volume, current
            raise

    def remove(self, organ):
        """Remove an organ with its nodes and its segment; another one becomes the current one.

        Parameters
        ----------
        organ : OrganParameters
        """
        node, nodes = organ.parameterNode, self.nodes()
        left = [other for other in nodes if other is not node]
        with slicer.util.NodeModify(self.parameters.parameterNode):
            if self.parameters.current is node:
                position = nodes.index(node) if node in nodes else 0
                self.parameters.current = left[min(position, len(left) - 1)] if left else None
            self.parameters.organs = left
        self._wrappers.pop(node.GetID(), None)
        removeNodes(nodesOf(organ))
        removeSegment(organ)
        slicer.mrmlScene.RemoveNode(node)
        # The legend may have been this organ's, and other organs may need one.
        updateLegends()

    def rename(self, organ, name):
        """Rename an organ and those of its nodes that a user has not renamed.

        Parameters
        ----------
        organ : OrganParameters
        name : str
            Nothing is done if it is blank or another organ's.
        """
        name, old = storable(name.strip()), organ.label
        if not name or name == old or name in self._names():
            return
        organ.label = name
        for node in nodesOf(organ):
            if node.GetName().startswith(f"{old} "):
                node.SetName(name + node.GetName()[len(old) :])
        paint(organ)

    def adopt(self):
        """Update the list after a scene was loaded: drop removed organs, and add those that are not listed."""
        self._wrappers.clear()
        nodes = self.nodes()
        for node in slicer.util.getNodesByClass("vtkMRMLScriptedModuleNode"):
            if node.GetAttribute(TYPE_ATTRIBUTE) == _ORGAN and node not in nodes:
                nodes.append(node)
        if list(self.parameters.organs) != nodes:
            self.parameters.organs = nodes
        if self.parameters.current is None and nodes:
            self.parameters.current = nodes[0]

    def _names(self):
        return [organ.label for organ in self]

    def _unusedName(self, name):
        names, count, name = self._names(), 2, storable(name)
        unused = name
        while unused in names:
            unused, count = f"{name} {count}", count + 1
        return unused

    def _unusedColor(self, name):
        if name in PRESETS:
            return PRESETS[name]
        used = [organ.color for organ in self]
        free = [color for color in _OTHER_COLORS if color not in used]
        return (free or _OTHER_COLORS)[0]


def storable(name):
    """Name that Slicer can save: with "&" in the name of a model, a saved scene is no valid XML and cannot be loaded.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        With "+" for "&".
    """
    return name.replace("&", "+")
