"""The demonstration: ``python -m VICRegistrationLib.demo DIR`` fits three organs in a synthetic pelvic MRI.

It paints an MRI with known organs, fits them from seeds as ``vic-registration fit`` does, prints the deviations from
the true surfaces, and writes the fitted ones as exact STEP solids and as one mesh of tetrahedra.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from .analysis.distances import deviation
from .analysis.references import ReadReference
from .cli.configuration import read_requests
from .cli.console import aligned, lines_to
from .cli.fitting import fit_to_folder
from .cli.organ_entries import FittedOrgan
from .cli.references import OrganReference
from .cli.stored_results import OVERVIEW, PAGE
from .files import replacing_folder, write_json
from .geometry.surface import BSplineSurface
from .phantoms.pelvis import pelvis_phantom, write_phantom

MESH_SIZE_MM = 3.0
_COLUMNS = ("organ", "mean", "signed", "95 %", "largest", "volume", "truth", "time")
_UNITS = ("", "mm", "mm", "mm", "mm", "ml", "ml", "s")


def run_demo(directory: Path) -> Path:
    """Make the phantom, fit its organs, and print a table of deviations from the truth.

    Parameters
    ----------
    directory : Path
        Parent of the folders ``phantom``, ``organs`` (with the exact solids as STEP files) and ``mesh``.

    Returns
    -------
    Path
        The picture to look at first.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    RuntimeError
        If matplotlib is not installed.
    """
    print("Making a synthetic sagittal T2-weighted MRI of a pelvis ...")
    phantom = pelvis_phantom()
    with replacing_folder(directory / "phantom") as drafts:
        write_phantom(phantom, drafts)
    run = fit_to_folder(
        directory / "phantom" / "mri.nii.gz",
        read_requests(directory / "phantom" / "organs.json"),
        directory / "organs",
        step=True,
        references=_references(phantom.surfaces, directory / "phantom" / "truth"),
    )
    _write_mesh(run.organs, directory / "mesh")
    print("\nDeviation of the fitted surfaces from the true ones (signed: positive is outside of the truth):\n")
    print(deviation_table(run.organs, phantom.surfaces))
    print(f"\nEverything on one page: {(directory / 'organs' / PAGE).resolve()}")
    return directory / "organs" / (OVERVIEW if len(run.organs) > 1 else f"{run.names[0]}.png")


def _references(truths: Mapping[str, BSplineSurface], folder: Path) -> dict[str, OrganReference]:
    """Make references of the true surfaces, with the paths of their files."""
    return {
        name: OrganReference(ReadReference(truth, "surface"), folder / f"{name}.json") for name, truth in truths.items()
    }


def _write_mesh(organs: Sequence[FittedOrgan], directory: Path) -> None:
    """Mesh the fitted organs together, and draw the mesh."""
    from .cli.solids import colored_solids
    from .meshing.formats import write_tetrahedra
    from .meshing.organ_meshes import mesh_organs
    from .meshing.process import MeshingError
    from .meshing.quality import quality
    from .meshing.regions import MeshOptions
    from .report.figure import save_figure
    from .report.pictures import mesh_figure

    print(f"\nMeshing the organs with elements of {MESH_SIZE_MM:g} mm ...")
    solids = colored_solids({organ.name: organ.fit.surface for organ in organs})
    try:
        mesh = mesh_organs(solids, MeshOptions(size=MESH_SIZE_MM))
    except MeshingError as error:
        # The demo goes on: gmsh may not be installed, or lack a system library.
        print(f"No mesh: {error}")
        return
    with replacing_folder(directory) as drafts:
        for suffix in (".vtu", ".msh"):
            write_tetrahedra(mesh, drafts / f"organs{suffix}")
        write_json(drafts / "organs.quality.json", quality(mesh).as_json())
        save_figure(mesh_figure(mesh, f"Mesh of {MESH_SIZE_MM:g} mm"), drafts / "organs.png")
    for line in quality(mesh).lines():
        print(line)
    print(f"written to {directory}: organs.vtu, organs.msh, organs.quality.json, organs.png")


def deviation_table(organs: Sequence[FittedOrgan], truths: Mapping[str, BSplineSurface]) -> str:
    """Make a table of deviations, volumes and times.

    Parameters
    ----------
    organs : sequence of FittedOrgan
    truths : mapping of str to BSplineSurface
        True surfaces by the organs' names.

    Returns
    -------
    str
        One line for each organ below two lines of titles and units.
    """
    rows = [_COLUMNS, _UNITS]
    for organ in organs:
        surface, truth = organ.fit.surface, truths[organ.name]
        found = deviation(surface, truth)
        distances = (f"{found.mean:.2f}", f"{found.mean_signed:+.2f}", f"{found.p95:.2f}", f"{found.maximum:.2f}")
        volumes = (f"{surface.volume() / 1000.0:.1f}", f"{truth.volume() / 1000.0:.1f}")
        rows.append((organ.name, *distances, *volumes, f"{organ.seconds:.2f}"))
    return aligned(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration.

    Parameters
    ----------
    arguments : sequence of str, optional
        The folder; by default the arguments of the process.

    Returns
    -------
    int
        0, or 2 after one line on stderr.
    """
    parser = argparse.ArgumentParser(prog="python -m VICRegistrationLib.demo", description=__doc__.splitlines()[0])
    parser.add_argument("directory", metavar="DIR", type=Path, help="folder for the MRI, the surfaces and the pictures")
    options = parser.parse_args(arguments)
    try:
        with lines_to(sys.stdout):
            picture = run_demo(options.directory)
    except (OSError, RuntimeError, ValueError) as error:
        print(f"demo: error: {error}", file=sys.stderr)
        return 2
    print(f"\nOpen this picture: {picture.resolve()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
