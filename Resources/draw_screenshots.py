"""Draw the pictures of Slicer's views: an organ separated, three fitted, corrected, compared, two stacks, a model.

The scene is filled by the module's own code and drawn by Slicer's displayable managers, but without Slicer: needs the
package slicer-core, and OpenGL that works off screen. The image is the demo's, with air in the bladder.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "VICRegistration"), str(ROOT / "Testing" / "Python")]

from slicer_stand_ins.install import install

APPLICATION = install().application

import slicer
from slicer_views import SLICES, SliceView, ThreeDView, draws_off_screen, side_by_side, write_png

from VICRegistration import VICRegistrationLogic
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.mrml import samples
from VICRegistrationLib.mrml.fitting import fitSteps
from VICRegistrationLib.mrml.generic_model_fit import fitModel
from VICRegistrationLib.mrml.generic_model_nodes import colorByPatch
from VICRegistrationLib.mrml.organ_nodes import setVisible
from VICRegistrationLib.mrml.stack_contours import chooseViews
from VICRegistrationLib.mrml.stacks import stacksOf
from VICRegistrationLib.mrml.surfaces import createModel, showSurface
from VICRegistrationLib.phantoms.painting import paint
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.registration.steps import finish

FOLDER = ROOT / "Resources" / "Screenshots"
VIEW_SIZE = (480, 360)
# From the patient's right and front, somewhat from above.
EYE = (0.7, 1.0, 0.25)
AIR_MM = 6.0
# Where the wall in front of the air is clicked, to the right and to the head of its foremost place.
CLICKS_MM = ((0, 0), (15, 0), (-15, 0), (0, 9), (0, -9))


def main() -> None:
    """Draw all pictures into Resources/Screenshots."""
    if not draws_off_screen():
        sys.exit("There is no OpenGL that draws off screen; install libegl1 or libosmesa6, or use xvfb-run.")
    phantom = pelvis_phantom()
    wall = triangulate(phantom.surfaces["bladder"]).points
    front, bladder_center = wall[wall[:, 1].argmax()], wall.mean(axis=0)
    all_organs = np.mean([surface.control_net.mean(axis=(0, 1)) for surface in phantom.surfaces.values()], axis=0)
    phantom = with_air_in_the_bladder(phantom, front[1] - AIR_MM)
    logic, volume = VICRegistrationLogic(), add_volume(phantom.image)
    views = Views(slicer.mrmlScene, volume)
    # One click in the middle of each organ.
    seeds = {name: seeds[len(seeds) // 2 :][:1] for name, seeds in phantom.seeds.items()}

    bladder = logic.addOrgan(volume, seeds["bladder"], name="bladder")
    views.draw("preview", seeds["bladder"][0], 120.0, middle=bladder_center)

    finish(fitSteps(bladder, volume))
    others = [logic.fit(volume, seeds[name], name=name) for name in ("vagina", "rectum")]
    for organ in (bladder, *others):
        print(f"{organ.label}: {organ.volumeMl:.1f} ml, {phantom.surfaces[organ.label].volume() / 1e3:.1f} ml in truth")
    views.draw("fitted", (front[0], *bladder_center[1:]), 150.0, middle=all_organs)

    left = logic.refit(bladder, clicks_on(wall[wall[:, 1] > bladder_center[1]], front))
    print(f"bladder corrected: {bladder.volumeMl:.1f} ml, {np.abs(left).max():.2f} mm from the boundary points")
    views.draw("corrected", front - (0, AIR_MM / 2, 0), 100.0, middle=bladder_center)

    bladder.boundaryPoints.GetDisplayNode().SetVisibility(False)
    for organ in (bladder, *others):
        found = logic.compare(organ, add_truth(phantom.surfaces[organ.label], organ.label))
        print(f"{organ.label}: {found.to_surface.mean:.2f} mm from the truth, Hausdorff {found.hausdorff:.2f} mm")
        # As in the panel after a fit: the contour is not to lie under the region.
        organ.regions.GetDisplayNode().SetVisibility(False)
    views.draw("compared", (front[0], *bladder_center[1:]), 150.0, middle=all_organs)
    remove_organs(logic)
    draw_stacks(logic, views, seeds, all_organs)
    remove_organs(logic)
    draw_model(logic, views, seeds, all_organs)


def remove_organs(logic):
    """Remove all organs from the scene."""
    for organ in list(logic.organs()):
        # The legend goes first.
        logic.color(organ)
        logic.organs().remove(organ)


def draw_stacks(logic, views, seeds, center):
    """Draw a sagittal and an axial stack, before which the patient has moved, with organs that are fitted to both."""
    sagittal, axial = samples.addPhantomVolume(), samples.addPhantomStack()
    for volume in (sagittal, axial):
        volume.CreateDefaultDisplayNodes()
    for name, seed in seeds.items():
        organ = logic.fit(sagittal, seed, name=name, further=[axial])
        organ.regions.GetDisplayNode().SetVisibility(False)
        organ.seeds.GetDisplayNode().SetVisibility(False)
        (record,) = stacksOf(organ).values()
        print(f"{name}: moved {record.shift:.1f} mm, {record.turn:.1f} degrees in the axial stack")
    views.draw_stacks("stacks", {"Red": axial, "Yellow": sagittal}, center, 130.0)


def draw_model(logic, views, seeds, center):
    """Draw a generic model that is fitted to three organs, with its patches."""
    volume = samples.addPhantomVolume()
    volume.CreateDefaultDisplayNodes()
    for name, seed in seeds.items():
        setVisible(logic.addOrgan(volume, seed, name=name), False)
    print(fitModel(logic.getParameterNode(), volume))
    colorByPatch(volume, True)
    views.draw("model", center, 190.0, middle=center, volume=volume)


def with_air_in_the_bladder(phantom, level):
    """Return the phantom with air in front of a level (mm along A) in the bladder, as after a catheter."""
    image, surface = phantom.image, triangulate(phantom.surfaces["bladder"])
    lumen = volume_fractions(surface.points, surface.triangles, image.array.shape, image.ijk_to_ras)
    k, j, i = np.indices(image.array.shape, sparse=True)
    to_ras = image.ijk_to_ras[1]
    height = to_ras[0] * i + to_ras[1] * j + to_ras[2] * k + to_ras[3] - level
    above = np.clip(height / min(image.spacing) + 0.5, 0.0, 1.0)
    air = ndimage.gaussian_filter(lumen * above, (0.0, 0.6, 0.6))
    noise = np.random.default_rng(0).rayleigh(45.0, air.shape)
    array = np.rint(paint(image.array, [(air, noise)])).astype(image.array.dtype)
    return dataclasses.replace(phantom, image=dataclasses.replace(image, array=array))


def add_volume(image):
    """Put an image into the scene."""
    volume = slicer.util.addVolumeFromArray(image.array, ijkToRAS=image.ijk_to_ras, name="MRI")
    volume.CreateDefaultDisplayNodes()
    return volume


def add_truth(surface, name):
    """Put the true surface of an organ into the scene, unseen."""
    node = createModel(f"{name} truth", (1.0, 1.0, 1.0))
    showSurface(node, surface, name=name)
    node.GetDisplayNode().SetVisibility(False)
    return node


def clicks_on(wall, front):
    """Places on the wall around its foremost one."""
    distances = np.linalg.norm((wall - front)[:, None, [0, 2]] - CLICKS_MM, axis=2)
    return wall[distances.argmin(axis=0)]


class Views:
    """The four views of Slicer's usual layout."""

    def __init__(self, scene, volume):
        self._volume = volume
        self._slices = {name: SliceView(scene, APPLICATION, name, VIEW_SIZE) for name in SLICES}
        self._threeD = ThreeDView(scene, APPLICATION, VIEW_SIZE)

    def draw(self, name, center, height_mm, *, middle, volume=None):
        """Write a picture of the slices through a place, and of what is around the middle in 3D."""
        for view in self._slices.values():
            view.show(volume or self._volume, center, height_mm)
        self._threeD.look(middle, EYE, 1.25 * height_mm)
        red, yellow, green = (self._slices[name].picture() for name in ("Red", "Yellow", "Green"))
        FOLDER.mkdir(exist_ok=True)
        write_png(side_by_side([[red, self._threeD.picture()], [green, yellow]]), FOLDER / f"{name}.png")

    def draw_stacks(self, name, volumes, center, height_mm):
        """Write a picture of slice views that show a volume each."""
        for view, volume in volumes.items():
            self._slices[view].show(volume, center, height_mm)
        chooseViews()
        write_png(side_by_side([[self._slices[view].picture() for view in volumes]]), FOLDER / f"{name}.png")


if __name__ == "__main__":
    main()
