"""Comparisons as a printed table and as files."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Sequence
from pathlib import Path

from ..export.mesh_files import write_vtp
from ..files import write_json, write_text
from ..report.contents import STATISTICS, ComparedOrgan
from .console import aligned
from .outputs import PROGRAM_VERSION

JSON, CSV = "comparison.json", "comparison.csv"
SCHEMA, VERSION = "vic-registration/comparison", 1
SCALARS = "Deviation"


def comparison_table(organs: Sequence[ComparedOrgan]) -> str:
    """Tables of the distances, of Dice and of the volumes.

    Parameters
    ----------
    organs : sequence of ComparedOrgan

    Returns
    -------
    str
        Lines.
    """
    distances = [("distances, mm", "", "mean", "std", "RMS", "median", "95 %", "largest", "signed")]
    common = []
    for organ in organs:
        found = organ.comparison
        distances += [(organ.name, *row) for row in organ.distance_rows]
        tolerances = [f"{tolerance:g} mm" for tolerance, _ in found.surface_dice]
        common.append(
            (
                organ.name,
                f"{found.hausdorff:.2f} mm",
                *(f"{share:.3f}" for _, share in found.surface_dice),
                f"{found.volume_dice:.3f}",
                f"{found.volume_ml:.1f} ml",
                f"{found.reference_ml:.1f} ml",
                f"{found.volume_difference_ml:+.1f} ml",
            )
        )
    titles = ("", "Hausdorff", *(f"Dice {each}" for each in tolerances), "volume Dice")
    return f"{aligned(distances)}\n\n{aligned([(*titles, 'volume', 'reference', 'difference'), *common])}"


def organs_before(folder: Path) -> list[str]:
    """Names of the organs whose comparison a folder holds.

    Parameters
    ----------
    folder : Path
        Need not exist.

    Returns
    -------
    list of str

    Raises
    ------
    ValueError
        If it holds files of these names that are no comparison.
    """
    there = [folder / name for name in (CSV, JSON) if (folder / name).exists()]
    if not there:
        return []
    try:
        content = json.loads((folder / JSON).read_text(encoding="utf-8"))
        if content["schema"] == SCHEMA:
            return list(content["organs"])
    except (OSError, ValueError, LookupError, TypeError):
        pass
    msg = f"{there[0]} exists and is no comparison; choose another folder for the output."
    raise ValueError(msg)


def organ_files(name: str, *, pictures: bool) -> list[str]:
    """Names of the files of one organ.

    Parameters
    ----------
    name : str
    pictures : bool
        Whether pictures are drawn.

    Returns
    -------
    list of str
    """
    return [f"{name}_deviation.vtp", *([f"{name}_deviation.png"] if pictures else [])]


def write_organ(organ: ComparedOrgan, folder: Path, *, pictures: bool) -> None:
    """Write the coloured triangles, and the picture.

    Parameters
    ----------
    organ : ComparedOrgan
    folder : Path
    pictures : bool

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If a file cannot be written.
    """
    files = organ_files(organ.name, pictures=pictures)
    write_vtp(organ.mesh, organ.surface, folder / files[0], name=organ.name, scalars={SCALARS: organ.distances})
    if pictures:
        from ..report.figure import save_figure
        from ..report.pictures import deviation_figure

        save_figure(deviation_figure(organ), folder / files[1])


def write_numbers(organs: Sequence[ComparedOrgan], folder: Path, *, points: int, pictures: bool) -> None:
    """Write comparison.csv and comparison.json.

    Parameters
    ----------
    organs : sequence of ComparedOrgan
    folder : Path
    points : int
        Number of points on each surface.
    pictures : bool
        Whether pictures are drawn.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    table = io.StringIO()
    rows = [_row(organ) for organ in organs]
    writer = csv.DictWriter(table, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "program": PROGRAM_VERSION,
        "frame": "RAS",
        "mesh_frame": "LPS",
        "unit": "mm",
        "points": points,
        "organs": {
            organ.name: {**_entry(organ), "files": organ_files(organ.name, pictures=pictures)} for organ in organs
        },
    }
    write_text(folder / CSV, table.getvalue())
    write_json(folder / JSON, content)


def _entry(organ: ComparedOrgan) -> dict:
    """Results of one organ for the JSON file."""
    found = organ.comparison
    return {
        "reference": str(organ.path),
        "kind": organ.read.kind,
        "label": organ.read.label or None,
        "to_surface": dataclasses.asdict(found.to_surface),
        "to_reference": dataclasses.asdict(found.to_reference),
        "hausdorff": found.hausdorff,
        "surface_dice": [{"tolerance": tolerance, "dice": share} for tolerance, share in found.surface_dice],
        "volume_dice": found.volume_dice,
        "volume_ml": found.volume_ml,
        "reference_ml": found.reference_ml,
        "volume_difference_ml": found.volume_difference_ml,
        "reference_notes": list(organ.read.notes),
        "warnings": [found.record() for found in organ.diagnostics],
    }


def _row(organ: ComparedOrgan) -> dict[str, str]:
    """Results of one organ for the CSV file; lengths in mm."""
    found = organ.comparison
    numbers = {
        f"{way}_{key}_mm": getattr(getattr(found, way), key)
        for way in ("to_surface", "to_reference")
        for key in (*STATISTICS, "mean_signed")
    }
    numbers["hausdorff_mm"] = found.hausdorff
    numbers.update({f"surface_dice_{tolerance:g}mm": share for tolerance, share in found.surface_dice})
    for key in ("volume_dice", "volume_ml", "reference_ml", "volume_difference_ml"):
        numbers[key] = getattr(found, key)
    texts = {"organ": organ.name, "reference": str(organ.path), "label": organ.read.label}
    return {**texts, **{key: repr(float(number)) for key, number in numbers.items()}}
