"""``vic-registration model fit``: from an image on disk and a generic model to a folder of results."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..file_names import folder_name
from ..imaging.image import Image
from ..multipatch.fit import ModelFit, check_organs, fit_model
from ..multipatch.landmarks import check_names, read_landmarks
from ..multipatch.library import DEFAULT, MODELS, find_model
from ..multipatch.model import MultiPatchModel
from ..registration.stacks import Stack
from ..registration.steps import finish
from ..report.figure import require_packages
from . import validators
from .configuration import OrganRequest, files_of, read_requests
from .console import LOG, argument
from .fitting import (
    StageLines,
    all_of,
    checked_folder,
    further_stacks,
    loaded_image,
    print_motions,
    print_outcome,
    separated_organs,
)
from .model_results import ModelResults
from .organ_entries import FittedOrgan
from .results_folder import Run, restored_organs, write_results

_NAMES = " or ".join(MODELS)
EPILOG = f"""\
The organs of a model are fitted together, to their regions and to the grey levels; everything that the image does not
show is carried along, and is called estimated wherever it is shown. At least two organs of the model must be in the
configuration, by the names that they have in the model; organs that are not there are predicted and called so. MODEL is
a file, {_NAMES} (default: {DEFAULT}).

Landmarks are places on bone, by the names that they have in the model (model show lists them): a point
list of Slicer (.mrk.json) with these labels, or a JSON object such as {{"coccyx, tip": [0.5, -63.0, -46.0]}}, RAS mm.

DIR gets what fit writes about each organ, and:
  model.json            the model, carried to the patient (RAS mm)
  model.step            exact faces with the names of its patches (LPS mm)
  model.vtp             triangles with the names of patches and parts (LPS mm)
  model.png             from four sides
report.html and report.json hold the smallest determinant of the map, how far attachments slid, distances from the
regions, and what was predicted or estimated.

examples:
  vic-registration model fit scan.nii.gz --config organs.json --landmarks bones.mrk.json --output pelvis
  vic-registration model fit sag.nii.gz --also ax.nii.gz --config organs.json
"""


def add_words(fit: argparse.ArgumentParser) -> None:
    """Add the words of the command to its parser.

    Parameters
    ----------
    fit : argparse.ArgumentParser
    """
    fit.add_argument("image", metavar="IMAGE", help="file, or a folder of DICOM slices, as of fit")
    fit.add_argument(
        "--also",
        metavar="IMAGE",
        action="append",
        help="another stack of the patient, file or folder: organs are fitted to all of them; may be repeated; "
        "FOLDER@SERIES or FILE@N chooses one of several",
    )
    fit.add_argument(
        "--config",
        metavar="FILE",
        required=True,
        help="JSON file with the organs and their seeds or regions, as of fit",
    )
    fit.add_argument("--model", metavar="MODEL", default=DEFAULT, help=f"file, {_NAMES} (default: {DEFAULT})")
    fit.add_argument("--landmarks", metavar="FILE", help="places on bone: .mrk.json of Slicer, or an object of names")
    fit.add_argument("--series", metavar="UID", help="which DICOM series of the folder")
    fit.add_argument(
        "--frame", metavar="N", type=argument(validators.frame), help="which volume of an image with several, from 1"
    )
    fit.add_argument(
        "--output",
        metavar="DIR",
        type=argument(folder_name),
        default="model",
        help="folder for the results (default: model)",
    )
    fit.add_argument("--no-pictures", action="store_true", help="leave the pictures out; they need matplotlib")
    fit.add_argument("--quiet", action="store_true", help="no progress on stderr, only warnings")


def run(options: argparse.Namespace) -> None:
    """Fit a generic model to an image and write everything about it into a folder."""
    pictures, folder = not options.no_pictures, Path(options.output)
    if pictures:
        require_packages("matplotlib", "jinja2")
    model = find_model(options.model)
    requests = read_requests(options.config, defaults={"also": options.also})
    check_organs(model, {request.name: request.options for request in requests})
    _check_requests(requests)
    landmarks = {} if options.landmarks is None else read_landmarks(options.landmarks)
    check_names(model, landmarks)
    stored = checked_folder(folder, _inputs(options, requests), requests, pictures=pictures, step=False, model=True)
    image, record, seconds_load = loaded_image(options.image, options.series, options.frame, stored)
    if pictures:
        restored_organs(stored, [request.name for request in requests], image)
    stacks = further_stacks(requests)
    fit, organs = _fitted(image, model, requests, landmarks, stacks)
    for organ in organs:
        print_outcome(organ, image, step=False)
    for diagnostic in fit.diagnostics:
        LOG.warning(f"model: {diagnostic.sentence()}")
    results = ModelResults(fit, str(options.model))
    write_results(Run(organs, image, record, seconds_load, pictures, False, model=results), folder)


def _inputs(options: argparse.Namespace, requests: Sequence[OrganRequest]) -> list[str]:
    """Files that must not be replaced."""
    given = [path for path in (options.model, options.landmarks) if path is not None and path not in MODELS]
    return [options.image, options.config, *files_of(requests), *given]


def _check_requests(requests: Sequence[OrganRequest]) -> None:
    """Refuse what only a fit of single organs takes."""
    for request in requests:
        if request.boundary:
            msg = (
                f"{request.name}: boundary points were given, which model fit does not take; leave the key boundary "
                "out, or fit the organ by itself."
            )
            raise ValueError(msg)


def _fitted(
    image: Image,
    model: MultiPatchModel,
    requests: Sequence[OrganRequest],
    landmarks: Mapping[str, np.ndarray],
    stacks: Mapping[str, Stack],
) -> tuple[ModelFit, list[FittedOrgan]]:
    """Separate the organs, and fit the model to them."""
    failed: dict[str, str] = {}
    separated = separated_organs(image, requests, failed)
    if failed:
        raise ValueError(all_of(failed))
    regions = {request.name: region for request, region, _ in separated}
    options = {request.name: request.options for request in requests}
    further = {request.name: [stacks[path] for path in request.also] for request in requests}
    lines = StageLines("model")
    fit = finish(fit_model(image, model, regions, options, landmarks=landmarks, further=further), on_step=lines)
    lines.end()
    organs = []
    for request, _, seconds in separated:
        found = fit.organs[request.name]
        print_motions(request.name, found.stacks)
        whole = seconds + found.seconds
        organs.append(FittedOrgan(request.name, found, request.seeds, whole, seconds, asked=request.options))
    return fit, organs
