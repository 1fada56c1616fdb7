"""``vic-registration simulate``: linear elasticity on a tetrahedral mesh."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from ..file_names import folder_name
from ..files import keep_inputs, replacing_folder
from . import validators
from .console import argument, speaker

_CASES = ("self-weight", "pressure")
_NAME = "simulation"

_EPILOG = f"""\
MESH is a file .msh or .vtu of `vic-registration mesh`, LPS mm. Linear elements are too stiff for nearly incompressible
tissue unless they are very small: take a mesh of second order (--order 2).

  self-weight  the organ's weight, on springs all over its outside that stand for its surroundings
  pressure     a pressure in the cavities of a hollow organ (mesh --wall); its outside is free without --foundation

DIR gets
  {_NAME}.vtu   displacement (mm) of the points; strain, stress and equivalent stress (kPa) of the elements; LPS
  {_NAME}.png   deformed organ with its displacement, and a cut with the stress
  {_NAME}.json  the problem, largest values, energies (uJ)

examples:
  vic-registration simulate bladder.msh --case self-weight --young 20 --output bladder_weight
  vic-registration simulate bladder_wall.msh --case pressure --pressure 2 --output bladder_pressure
"""


def add_parser(subparsers, add_command: Callable) -> None:
    """Add the words of the command.

    Parameters
    ----------
    subparsers
        Of argparse.
    add_command : callable
        Makes a parser from subparsers, name, summary and function.
    """
    parser = add_command(subparsers, "simulate", "deform an organ's mesh by finite elements", run, epilog=_EPILOG)
    parser.add_argument("mesh", metavar="MESH", help="tetrahedral mesh: .msh or .vtu")
    parser.add_argument("--case", choices=_CASES, required=True, help="what acts on the organ")
    material = parser.add_argument_group("material (the same everywhere)")
    material.add_argument(
        "--young", metavar="KPA", type=argument(validators.number), default=300.0, help="Young's modulus (default: 300)"
    )
    material.add_argument(
        "--poisson",
        metavar="NU",
        type=argument(validators.number),
        default=0.45,
        help="Poisson's ratio (0.45)",
    )
    material.add_argument(
        "--density", metavar="KG/M3", type=argument(validators.number), help="for self-weight (default: 1050)"
    )
    load = parser.add_argument_group("load and support")
    load.add_argument(
        "--pressure", metavar="KPA", type=argument(validators.number), help="for pressure (default: 1, about 10 cmH2O)"
    )
    load.add_argument("--surface", metavar="GROUP", help="triangles that the pressure acts on (default: all cavities)")
    load.add_argument(
        "--gravity",
        metavar="R,A,S",
        type=argument(_direction),
        help="direction of the weight (default: 0,-1,0, on the back)",
    )
    load.add_argument(
        "--foundation",
        metavar="KPA/MM",
        type=argument(validators.number),
        help="springs of the surroundings (default: 0.3 for self-weight, 0 for pressure)",
    )
    what = parser.add_argument_group("what comes out")
    what.add_argument(
        "--output",
        metavar="DIR",
        type=argument(folder_name),
        default="simulation",
        help="folder for the results (default: simulation)",
    )
    what.add_argument("--no-pictures", action="store_true", help="leave the picture out; it needs matplotlib")
    what.add_argument("--quiet", action="store_true", help="no progress on stderr")


def run(options: argparse.Namespace) -> None:
    """Solve the problem and write everything about it into a folder.

    Parameters
    ----------
    options : argparse.Namespace

    Raises
    ------
    ValueError, OSError, RuntimeError
        With a sentence for the user.
    """
    from ..report.canvas import require_matplotlib
    from ..simulation.elements import require_scikit_fem
    from ..simulation.reading import read_mesh
    from ..simulation.result_files import write_report, write_vtu
    from ..simulation.solution import solve

    problem, material = _problem(options)
    require_scikit_fem()
    if not options.no_pictures:
        require_matplotlib()

    say = speaker(options.quiet)

    endings = (".vtu", ".png", ".json")
    keep_inputs([Path(options.output, _NAME + ending) for ending in endings], [options.mesh])
    mesh = read_mesh(options.mesh)
    outdated = (f"{_NAME}.png",) if options.no_pictures else ()
    with replacing_folder(options.output, outdated=outdated) as drafts:
        # A folder that cannot be written to is found out before the work.
        solution = solve(mesh, problem, material, on_progress=say)
        files = [f"{_NAME}.vtu"]
        write_vtu(solution, drafts / files[0])
        if not options.no_pictures:
            from ..simulation.picture import simulation_picture

            files.append(f"{_NAME}.png")
            simulation_picture(drafts / files[1], solution, Path(options.mesh).stem)
        write_report(solution, drafts / f"{_NAME}.json", mesh=Path(options.mesh).name, files=files)
    for note in solution.notes:
        print(f"warning: {note}", file=sys.stderr)
    say(f"results written to {options.output}")


def _problem(options: argparse.Namespace):
    """Problem and material of the words; words of the other case are refused."""
    from ..simulation.problems import InnerPressure, Material, SelfWeight

    own = {"self-weight": ("density", "gravity"), "pressure": ("pressure", "surface")}
    for case in _CASES:
        given = [word for word in own[case] if getattr(options, word) is not None]
        if case != options.case and given:
            msg = f"--{given[0]} was given, which belongs to --case {case}; leave it out, or change the case."
            raise ValueError(msg)
    chosen = {
        "density": options.density,
        "direction": options.gravity,
        "pressure": options.pressure,
        "surface": options.surface,
        "foundation": options.foundation,
    }
    chosen = {word: value for word, value in chosen.items() if value is not None}
    density = {"density": chosen.pop("density")} if "density" in chosen else {}
    material = Material(young=options.young, poisson=options.poisson, **density)
    return (SelfWeight if options.case == "self-weight" else InnerPressure)(**chosen), material


def _direction(text: str) -> tuple[float, float, float]:
    """Check a direction: R, A, S."""
    try:
        return validators.seed(text)
    except ValueError as error:
        msg = f"{text!r} was given; a direction is three numbers R,A,S"
        raise ValueError(msg) from error
