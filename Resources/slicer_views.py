"""Slicer's slice and 3D views without Slicer: its own displayable managers drawing a scene off screen.

What a view shows is decided by the same code as in Slicer (the package slicer-core on PyPI); only the window around it,
the coloured bar at the top and the letters at the edges are made here.
"""

from __future__ import annotations

import os
import subprocess
import sys
from ctypes.util import find_library

import numpy as np
import SimpleITK
import slicer
import vtk
from vtk.util.numpy_support import vtk_to_numpy

# Name, orientation, axis of the offset, colour of the bar, and what lies to the right of and above the picture.
SLICES = {
    "Red": ("Axial", "S", (0.95, 0.29, 0.20), "L", "A"),
    "Yellow": ("Sagittal", "R", (0.93, 0.84, 0.30), "P", "S"),
    "Green": ("Coronal", "A", (0.43, 0.69, 0.29), "L", "S"),
}
_OPPOSITE = {"L": "R", "R": "L", "P": "A", "A": "P", "S": "I", "I": "S"}
_3D_COLOR = (0.46, 0.46, 0.89)
# Software OpenGL leaves dark specks where triangles are smaller than pixels.
_3D_OVERSAMPLING = 3
_BAR_PX, _LETTER_PX, _GAP_PX = 18, 14, 2
_SLICE_MANAGERS = (
    "vtkMRMLModelSliceDisplayableManager",
    "vtkMRMLSegmentationsDisplayableManager2D",
    "vtkMRMLMarkupsDisplayableManager",
    "vtkMRMLColorLegendDisplayableManager",
)
_3D_MANAGERS = (
    "vtkMRMLCameraDisplayableManager",
    "vtkMRMLViewDisplayableManager",
    "vtkMRMLModelDisplayableManager",
    "vtkMRMLSegmentationsDisplayableManager3D",
    "vtkMRMLMarkupsDisplayableManager",
    "vtkMRMLColorLegendDisplayableManager",
)


# Without a screen VTK tries X first, and says so, before it takes EGL.
if sys.platform == "linux" and not os.environ.get("DISPLAY") and find_library("EGL"):
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


_PROBE = """
import vtk
window = vtk.vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(8, 8)
window.Render()
raise SystemExit(not window.SupportsOpenGL())
"""


def draws_off_screen() -> bool:
    """Tell whether there is OpenGL for these views.

    Returns
    -------
    bool
        Tried in another process: without OpenGL the first drawing ends the process.
    """
    return subprocess.run([sys.executable, "-c", _PROBE], check=False, capture_output=True).returncode == 0


class _View:
    """A window off screen with a group of displayable managers that draw a view node's scene into it."""

    def __init__(self, size, factory, managers, application, oversampling=1):
        self._oversampling = oversampling
        size = [oversampling * int(pixels) for pixels in size]
        self.renderer = vtk.vtkRenderer()
        self.window = vtk.vtkRenderWindow()
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(8)
        self.window.SetSize(*size)
        self.window.AddRenderer(self.renderer)
        # Displayable managers ask for an interactor; this one waits for no mouse.
        self._interactor = vtk.vtkGenericRenderWindowInteractor()
        self._interactor.SetRenderWindow(self.window)
        factory = factory.GetInstance()
        factory.SetMRMLApplicationLogic(application)
        for manager in managers:
            if not factory.IsDisplayableManagerRegistered(manager):
                factory.RegisterDisplayableManager(manager)
        self._managers = slicer.vtkMRMLDisplayableManagerGroup()
        self._managers.Initialize(factory, self.renderer)

    def _rendered(self):
        """Pixels of the window as (height, width, 3) uint8, top row first."""
        self.window.Render()
        grab = vtk.vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.SetInputBufferTypeToRGB()
        grab.ReadFrontBufferOff()
        grab.Update()
        width, height, _ = grab.GetOutput().GetDimensions()
        pixels = vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
        n = self._oversampling
        blocks = pixels.reshape(height // n, n, width // n, n, 3)[::-1]
        return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)

    def _add_text(self, text, place, color, size):
        """Put a text at a place in pixels of the window from its lower left corner."""
        actor = vtk.vtkTextActor()
        actor.SetInput(text)
        actor.SetPosition(*place)
        style = actor.GetTextProperty()
        style.SetFontSize(size)
        style.SetColor(*color)
        style.SetJustificationToCentered()
        style.SetVerticalJustificationToCentered()
        self.renderer.AddViewProp(actor)
        return actor

    def _add_bar(self, text, color):
        """Put Slicer's coloured bar with a text along the top."""
        (width, height), thickness = self.window.GetSize(), _BAR_PX * self._oversampling
        points = vtk.vtkPoints()
        for x, y in ((0, height - thickness), (width, height - thickness), (width, height), (0, height)):
            points.InsertNextPoint(x, y, 0)
        quad = vtk.vtkCellArray()
        quad.InsertNextCell(4, range(4))
        data = vtk.vtkPolyData()
        data.SetPoints(points)
        data.SetPolys(quad)
        mapper = vtk.vtkPolyDataMapper2D()
        mapper.SetInputData(data)
        bar = vtk.vtkActor2D()
        bar.SetMapper(mapper)
        bar.GetProperty().SetColor(*color)
        self.renderer.AddViewProp(bar)
        return self._add_text(text, (width / 2, height - thickness / 2), (0.1, 0.1, 0.1), int(0.75 * thickness))

    def close(self):
        """Let go of the window; the view is of no use afterwards."""
        self.window.Finalize()


class SliceView(_View):
    """One of Slicer's three slice views.

    Parameters
    ----------
    scene : vtkMRMLScene
    application : vtkMRMLApplicationLogic
        That of the scene.
    name : {"Red", "Yellow", "Green"}
    size : (int, int)
        Width and height in pixels.
    """

    def __init__(self, scene, application, name, size):
        super().__init__(size, slicer.vtkMRMLSliceViewDisplayableManagerFactory, _SLICE_MANAGERS, application)
        orientation, self._axis, color, right, top = SLICES[name]
        self.renderer.GetActiveCamera().ParallelProjectionOn()
        slicer.vtkMRMLSliceNode.AddDefaultSliceOrientationPresets(scene, True)
        self.logic = slicer.vtkMRMLSliceLogic()
        self.logic.SetMRMLApplicationLogic(application)
        self.logic.SetMRMLScene(scene)
        self.node = _view_node(scene, "vtkMRMLSliceNode", name)
        self.logic.SetSliceNode(self.node)
        self.node.SetOrientation(orientation)
        self.logic.ResizeSliceNode(*size)
        self._image = vtk.vtkImageMapper()
        # The slice logic gives finished colours, so that this window must leave them as they are.
        self._image.SetColorWindow(255)
        self._image.SetColorLevel(127.5)
        actor = vtk.vtkActor2D()
        actor.SetMapper(self._image)
        actor.GetProperty().SetDisplayLocationToBackground()
        self.renderer.AddViewProp(actor)
        # After the image: what is added later is drawn over it.
        self._managers.SetMRMLDisplayableNode(self.node)
        self._name, self._title = name, self._add_bar("", color)
        self._add_letters(right, top)

    def _add_letters(self, right, top):
        width, height = self.window.GetSize()
        middle = (height - _BAR_PX) / 2
        for letter, place in (
            (right, (width - _LETTER_PX, middle)),
            (_OPPOSITE[right], (_LETTER_PX, middle)),
            (top, (width / 2, height - _BAR_PX - _LETTER_PX)),
            (_OPPOSITE[top], (width / 2, _LETTER_PX)),
        ):
            self._add_text(letter, place, (1, 1, 1), _LETTER_PX)

    def show(self, volume, center, height_mm):
        """Show a volume around a place.

        Parameters
        ----------
        volume : vtkMRMLScalarVolumeNode
        center : (3,) array_like
            World RAS mm: the slice goes through it, and it comes to the middle of the view.
        height_mm : float
            What the view shows from its lower to its upper edge.
        """
        self.logic.GetSliceCompositeNode().SetBackgroundVolumeID(volume.GetID())
        width, height = self.window.GetSize()
        self.node.SetFieldOfView(height_mm * width / height, height_mm, self.node.GetFieldOfView()[2])
        to_ras = self.node.GetSliceToRAS()
        for row, value in enumerate(center):
            to_ras.SetElement(row, 3, float(value))
        self.node.UpdateMatrices()

    def picture(self):
        """Draw the view.

        Returns
        -------
        (height, width, 3) uint8 ndarray
            Top row first.
        """
        self.logic.UpdatePipeline()
        self._image.SetInputConnection(self.logic.GetImageDataConnection())
        self._title.SetInput(f"{self._name[0]}   {self._axis}: {self.logic.GetSliceOffset():.1f} mm")
        return self._rendered()


class ThreeDView(_View):
    """Slicer's 3D view.

    Parameters
    ----------
    scene : vtkMRMLScene
    application : vtkMRMLApplicationLogic
        That of the scene.
    size : (int, int)
        Width and height in pixels.
    """

    def __init__(self, scene, application, size):
        super().__init__(
            size, slicer.vtkMRMLThreeDViewDisplayableManagerFactory, _3D_MANAGERS, application, _3D_OVERSAMPLING
        )
        self.node = _view_node(scene, "vtkMRMLViewNode", "1")
        self.node.SetBoxVisible(False)
        # Or control points would be as small as the pixels of the window.
        self.node.SetScreenScaleFactor(_3D_OVERSAMPLING * self.node.GetScreenScaleFactor())
        self._managers.SetMRMLDisplayableNode(self.node)
        self._add_bar("1", _3D_COLOR)

    def look(self, center, towards, height_mm):
        """Point the camera.

        Parameters
        ----------
        center : (3,) array_like
            World RAS mm; it comes to the middle of the view.
        towards : (3,) array_like
            Direction from there to the eye.
        height_mm : float
            What the view shows from its lower to its upper edge at the distance of `center`.
        """
        manager = self._managers.GetDisplayableManagerByClassName("vtkMRMLCameraDisplayableManager")
        camera = manager.GetCameraNode()
        towards = np.asarray(towards, float) / np.linalg.norm(towards)
        distance = height_mm / 2 / np.tan(np.radians(camera.GetViewAngle()) / 2)
        camera.SetFocalPoint(*center)
        camera.SetPosition(*(np.asarray(center) + distance * towards))
        camera.SetViewUp(0, 0, 1)
        # Puts the letters R, L, A, P, S, I around what is seen, as Slicer's button for centring does.
        self.node.InvokeEvent(slicer.vtkMRMLViewNode.ResetFocalPointRequestedEvent)
        self.renderer.ResetCameraClippingRange()

    def picture(self):
        """Draw the view.

        Returns
        -------
        (height, width, 3) uint8 ndarray
            Top row first.
        """
        return self._rendered()


def _view_node(scene, kind, layout_name):
    """View node of the scene with this layout name, as new."""
    node = scene.CreateNodeByClass(kind)
    node.UnRegister(None)
    node.SetName(layout_name)
    node.SetLayoutName(layout_name)
    # If the scene has a node of this layout name it takes over the new one's values, and is returned instead of it.
    return scene.AddNode(node)


def side_by_side(pictures):
    """Put pictures of one size together as Slicer's four-up layout does.

    Parameters
    ----------
    pictures : sequence of sequence of (height, width, 3) uint8 ndarray
        Row by row.

    Returns
    -------
    (height, width, 3) uint8 ndarray
        With a narrow dark gap between them.
    """
    rows = [_joined(row, axis=1) for row in pictures]
    return _joined(rows, axis=0)


def _joined(pictures, axis):
    shape = list(pictures[0].shape)
    shape[axis] = _GAP_PX
    gap = np.full(shape, 40, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)][1:]
    return np.concatenate(parts, axis=axis)


def write_png(picture, path):
    """Write a picture.

    Parameters
    ----------
    picture : (height, width, 3) uint8 ndarray
        Top row first.
    path : path
    """
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(picture, isVector=True), str(path))
