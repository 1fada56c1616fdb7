"""From a separated region to a surface: this library's fit against VTK's contour with smoothing."""

from __future__ import annotations

from statistics import median

import numpy as np
from measuring import interleaved_seconds, ratio, table
from scenes import Scene, bladder_scenes, demo_scenes
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkSMPTools
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkWindowedSincPolyDataFilter
from vtkmodules.vtkFiltersGeneral import vtkDiscreteFlyingEdges3D

from VICRegistrationLib.analysis.reference_meshes import turned_alike
from VICRegistrationLib.export.surface_data import triangles_in
from VICRegistrationLib.imaging.region import Region
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.steps import finish

# Slicer's closed surface conversion with its default smoothing factor.
SMOOTHING_FACTOR = 0.5
# Given by the user, so that no finer one is tried.
PLAIN_NET = (9, 7)


def smoothed_contour(region: Region):
    """VTK's surface of a region, smoothed on the voxels' grid as Slicer does; vtkPolyData in padded (i, j, k)."""
    mask = np.pad(region.mask.astype(np.uint8), 1)
    volume = vtkImageData()
    volume.SetDimensions(*mask.shape[::-1])
    scalars = numpy_to_vtk(mask.ravel())
    volume.GetPointData().SetScalars(scalars)
    contour = vtkDiscreteFlyingEdges3D()
    contour.SetInputData(volume)
    contour.SetValue(0, 1)
    contour.ComputeNormalsOff()
    contour.ComputeGradientsOff()
    smoother = vtkWindowedSincPolyDataFilter()
    smoother.SetInputConnection(contour.GetOutputPort())
    smoother.SetNumberOfIterations(round(20 + 40 * SMOOTHING_FACTOR))
    smoother.SetPassBand(10.0 ** (-4.0 * SMOOTHING_FACTOR))
    smoother.BoundarySmoothingOff()
    smoother.FeatureEdgeSmoothingOff()
    smoother.NonManifoldSmoothingOn()
    smoother.NormalizeCoordinatesOn()
    smoother.Update()
    return smoother.GetOutput()


def contour_in_world(mesh, region: Region) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (RAS mm), triangles and vertex normals (pointing outward) of a contour."""
    points, triangles = triangles_in(mesh)
    turned = turned_alike(region.image.to_ras(points - 1.0), triangles)
    return (*triangles_in(turned), vtk_to_numpy(turned.GetPointData().GetNormals()).astype(float))


def measured(scene: Scene, repeats: int) -> dict[str, object]:
    """Time both ways for one organ."""
    seconds = interleaved_seconds(
        {
            "fit": lambda: finish(fit_region(scene.image, scene.region)),
            "plain": lambda: finish(fit_region(scene.image, scene.region, FitOptions(net=PLAIN_NET))),
            "vtk": lambda: smoothed_contour(scene.region),
        },
        repeats,
    )
    fit, contour = finish(fit_region(scene.image, scene.region)), smoothed_contour(scene.region)
    return {
        "ratio": ratio(seconds["fit"], seconds["vtk"]),
        "plain ratio": ratio(seconds["plain"], seconds["vtk"]),
        **{name: median(times) for name, times in seconds.items()},
        "net": "{}x{}".format(*fit.options.net),
        "iterations": fit.iterations,
        "vertices": contour.GetNumberOfPoints(),
    }


def report(*, quick: bool) -> str:
    """Compare all organs."""
    scenes = demo_scenes()
    real = bladder_scenes()
    results = {scene.name: measured(scene, 3 if quick else 11) for scene in scenes + (real[:1] if quick else real)}
    rows = [["organ", "fit / VTK", "9x7 / VTK", "fit ms", "9x7 ms", "VTK ms", "net", "iterations", "VTK vertices"]]
    for name, r in results.items():
        times = [
            f"{r['ratio']:.1f}",
            f"{r['plain ratio']:.2f}",
            *(f"{1e3 * r[way]:.0f}" for way in ("fit", "plain", "vtk")),
        ]
        rows.append([name, *times, r["net"], str(r["iterations"]), str(r["vertices"])])
    if not real:
        skipped = "  Real bladders were skipped: ../shared/data/bladder_mri is not there."
    else:
        skipped = f"  Real bladders: {', '.join(scene.name for scene in real if scene.name in results)}."
    threads = vtkSMPTools.GetEstimatedDefaultNumberOfThreads()
    return "\n\n".join(
        [
            "  fit: fit_region, default options, the net is chosen; 9x7: with that net given. How good: see accuracy.\n"
            "  VTK: vtkDiscreteFlyingEdges3D and vtkWindowedSincPolyDataFilter on the padded region, 40 iterations, "
            f"pass\n  band 0.01, backend {vtkSMPTools.GetBackend()}, threads up to {threads}.",
            table(rows),
            skipped,
        ]
    )
