"""From a separated region to a surface: this library's fit against VTK's contour with smoothing."""

from __future__ import annotations

from statistics import median

import numpy as np
from measuring import interleaved_seconds, ratio, table
from scenes import Scene, bladder_scenes, demo_scenes
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkSMPTools
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkPolyDataNormals, vtkWindowedSincPolyDataFilter
from vtkmodules.vtkFiltersGeneral import vtkDiscreteFlyingEdges3D

from VICRegistrationLib.export.surface_data import polydata
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.separation import Region
from VICRegistrationLib.registration.organ import finish, fit_region

# Slicer's closed surface conversion with its default smoothing factor.
SMOOTHING_FACTOR = 0.5
N_POINTS = 4000


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
    points = region.image.to_ras(vtk_to_numpy(mesh.GetPoints().GetData()).astype(float) - 1.0)
    triangles = vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)
    normals = vtkPolyDataNormals()
    normals.SetInputData(polydata(points, triangles))
    normals.SplittingOff()
    normals.ConsistencyOn()
    normals.AutoOrientNormalsOn()
    normals.Update()
    output = normals.GetOutput()
    triangles = vtk_to_numpy(output.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)
    points = vtk_to_numpy(output.GetPoints().GetData()).astype(float)
    return points, triangles, vtk_to_numpy(output.GetPointData().GetNormals()).astype(float)


def errors(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, truth: BSplineSurface) -> dict[str, float]:
    """Distances (mm) from the truth and angles (degrees) of normals, at points spread over the area of a mesh."""
    corners = points[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = np.random.default_rng(0).choice(len(triangles), N_POINTS, p=areas / areas.sum())
    own = normals[triangles[chosen]].mean(axis=1)
    found = closest_points(truth, corners[chosen].mean(axis=1))
    cosines = np.einsum("nk,nk->n", own, truth.normals(*found.parameters.T)) / np.linalg.norm(own, axis=1)
    distances = np.abs(found.distances)
    return {
        "mean": float(distances.mean()),
        "p95": float(np.percentile(distances, 95)),
        "angle": float(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).mean()),
    }


def measured(scene: Scene, repeats: int) -> dict[str, object]:
    """Time and, where the truth is known, error of both ways for one organ."""
    seconds = interleaved_seconds(
        {
            "fit": lambda: finish(fit_region(scene.image, scene.region)),
            "vtk": lambda: smoothed_contour(scene.region),
        },
        repeats,
    )
    fit, contour = finish(fit_region(scene.image, scene.region)), smoothed_contour(scene.region)
    result: dict[str, object] = {
        "ratio": ratio(seconds["fit"], seconds["vtk"]),
        "fit": median(seconds["fit"]),
        "vtk": median(seconds["vtk"]),
        "iterations": fit.iterations,
        "vertices": contour.GetNumberOfPoints(),
    }
    if scene.truth is not None:
        mesh = triangulate(fit.surface, resolution=(160, 100))
        result["fit errors"] = errors(mesh.points, mesh.triangles, mesh.normals, scene.truth)
        result["vtk errors"] = errors(*contour_in_world(contour, scene.region), scene.truth)
    return result


def report(*, quick: bool) -> str:
    """Compare all organs."""
    scenes = demo_scenes()
    real = bladder_scenes()
    results = {scene.name: measured(scene, 5 if quick else 21) for scene in scenes + (real[:1] if quick else real)}
    rows = [["organ", "fit / VTK", "fit ms", "VTK ms", "iterations", "VTK vertices"]]
    for name, r in results.items():
        times = [f"{r['ratio']:.2f}", f"{1e3 * r['fit']:.1f}", f"{1e3 * r['vtk']:.1f}"]
        rows.append([name, *times, str(r["iterations"]), str(r["vertices"])])
    accuracy = [["deviation from the truth", "mean mm", "95 % mm", "normals deg"]]
    for name, r in results.items():
        for way in ("fit", "vtk"):
            found = r.get(f"{way} errors")
            if found:
                numbers = [f"{found['mean']:.2f}", f"{found['p95']:.2f}", f"{found['angle']:.1f}"]
                accuracy.append([f"{name}, {'VTK' if way == 'vtk' else way}", *numbers])
    if not real:
        skipped = "  Real bladders were skipped: ../shared/data/bladder_mri is not there."
    else:
        skipped = f"  Real bladders: {', '.join(scene.name for scene in real if scene.name in results)}; see experts."
    threads = vtkSMPTools.GetEstimatedDefaultNumberOfThreads()
    return "\n\n".join(
        [
            "  fit: fit_region, default options.\n"
            "  VTK: vtkDiscreteFlyingEdges3D and vtkWindowedSincPolyDataFilter on the padded region, 40 iterations, "
            f"pass\n  band 0.01, backend {vtkSMPTools.GetBackend()}, threads up to {threads}.",
            table(rows),
            table(accuracy),
            skipped,
        ]
    )
