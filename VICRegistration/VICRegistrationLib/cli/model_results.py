"""Files, report entry and section of the page for a fitted generic model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..multipatch.fit import ModelFit
from ..multipatch.formats import MODEL, MODEL_STEP, MODEL_VTP, write_model_files
from ..multipatch.model import Part
from ..multipatch.picture import model_figure
from ..report.contents import ReportedModel
from ..report.figure import save_figure
from .console import LOG

MODEL_PICTURE = "model.png"
_TITLES = ("part", "kind", "from", "volume or thickness", "distance from the region", "sliding")


def model_files(*, pictures: bool) -> list[str]:
    """Names of the files of a model.

    Parameters
    ----------
    pictures : bool

    Returns
    -------
    list of str
    """
    return [MODEL, MODEL_STEP, MODEL_VTP, *([MODEL_PICTURE] if pictures else [])]


@dataclass(frozen=True, eq=False)
class ModelResults:
    """A fitted model.

    Parameters
    ----------
    fit : ModelFit
    path : str
        The model as the user gave it: a name or a file.
    """

    fit: ModelFit
    path: str

    def write(self, folder: Path, *, pictures: bool) -> list[str]:
        """Write its files.

        Parameters
        ----------
        folder : Path
        pictures : bool

        Returns
        -------
        list of str
            Their names.
        """
        names, problem = write_model_files(self.fit.model, folder)
        if problem:
            LOG.warning(f"model: warning: {problem}")
        if pictures:
            save_figure(self._figure, folder / MODEL_PICTURE)
            names.append(MODEL_PICTURE)
        return names

    def entry(self) -> dict[str, object]:
        """Make its entry of report.json: lengths in mm, places in RAS."""
        fit = self.fit
        determinant, part = fit.smallest_determinant
        return {
            "model": self.path,
            "name": fit.model.name,
            "placement": fit.placement.matrix.tolist(),
            "scale": fit.placement.scale,
            "turn_degrees": fit.placement.degrees,
            "distance_from_region_mm": fit.deviations,
            "smallest_determinant": determinant,
            "smallest_determinant_at": part,
            "sliding_mm": fit.sliding,
            "landmarks_mm": fit.landmarks,
            "predicted": list(fit.predicted),
            "estimated": list(fit.estimated),
            "seconds": fit.seconds,
            "diagnostics": [diagnostic.record() for diagnostic in fit.diagnostics],
        }

    def reported(self) -> ReportedModel:
        """Make its section of report.html."""
        fit = self.fit
        determinant, part = fit.smallest_determinant
        rows = [
            ("Model", self.path),
            ("Placed", f"{fit.placement.scale:.2f} times as large, turned by {fit.placement.degrees:.0f} degrees"),
            ("Organs seen in the image", ", ".join(fit.organs)),
            ("Organs predicted", ", ".join(fit.predicted) or "none"),
            (
                "Smallest determinant",
                f"{determinant:.2f}, near {part}: smallest ratio of volume after the map to volume before",
            ),
            *((f"Landmark {name}", f"met within {away:.1f} mm") for name, away in fit.landmarks.items()),
            ("Time", f"{fit.seconds:.2f} s from the regions to the carried model"),
        ]
        notes = [diagnostic.sentence() for diagnostic in fit.diagnostics]
        return ReportedModel(
            fit.model.name or self.path,
            rows,
            [self._row(each) for each in fit.model.parts],
            _TITLES,
            notes,
            self._figure,
        )

    @cached_property
    def _figure(self):
        """The picture for the file and the page."""
        return model_figure(self.fit.model)

    def _row(self, part: Part) -> tuple[str, ...]:
        fit = self.fit
        origin = "the image" if part.name in fit.organs else "the generic model"
        size = f"{part.thickness:g} mm" if part.thickness is not None else ""
        if part.name in fit.model.parents:
            size = f"{fit.model.parents[part.name].volume() / 1000.0:.1f} ml"
        lengths = [
            f"{values[part.name]:.2f} mm" if part.name in values else "" for values in (fit.deviations, fit.sliding)
        ]
        return part.labelled(), part.kind, origin, size, *lengths
