"""``vic-registration model fit``: from an image on disk and a generic model to a folder of results."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from ..imaging.image import Image
from ..multipatch.fit import check_organs, fit_model
from ..multipatch.landmarks import check_names, read_landmarks
from ..multipatch.library import DEFAULT, MODELS, find_model
from ..multipatch.model import MultiPatchModel
from ..registration.stacks import Stack
from ..registration.steps import finish
from .configuration import OrganRequest, files_of, read_requests
from .console import add_command
from .fit_command import add_image, add_output
from .fitting import Separated, fit_to_folder, print_motions, stage_lines
from .model_results import ModelResults
from .organ_entries import FittedOrgan

_NAMES = " or ".join(MODELS)
_EPILOG = f"""\
The organs of a model are fitted together, to their regions and to the grey levels. Parts that the image does not show
are carried along, and marked as estimated in all results. At least two organs of the model must be in the
configuration, with their names in the model; the others are predicted, and marked as such. MODEL is a file,
{_NAMES} (default: {DEFAULT}).

Landmarks are points on bone with the names that the model has for them (model show lists them): a point
list of Slicer (.mrk.json) with these labels, or a JSON object such as {{"coccyx, tip": [0.5, -63.0, -46.0]}}, RAS mm.

DIR gets the files of fit for each organ, and:
  model.json            the model, carried to the patient (RAS mm)
  model.step            exact faces with the names of its patches (LPS mm)
  model.vtp             triangles with the names of patches and parts (LPS mm)
  model.png             picture from four sides
report.html and report.json have the smallest determinant of the map, the sliding of attachments, distances from the
regions, and the parts that were predicted or estimated.

examples:
  vic-registration model fit scan.nii.gz --config organs.json --landmarks bones.mrk.json --output pelvis
  vic-registration model fit sag.nii.gz --also ax.nii.gz --config organs.json
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "fit", "fit a model to an image", run, epilog=_EPILOG)
    add_image(parser)
    parser.add_argument(
        "--config",
        metavar="FILE",
        required=True,
        help="JSON file with the organs and their seeds or regions, as for fit",
    )
    parser.add_argument("--model", metavar="MODEL", default=DEFAULT, help=f"file, {_NAMES} (default: {DEFAULT})")
    parser.add_argument(
        "--landmarks", metavar="FILE", help="points on bone: .mrk.json of Slicer, or a JSON object of names"
    )
    add_output(parser, "model")


def run(options: argparse.Namespace) -> None:
    """Fit a generic model to an image and write the results into a folder."""
    model = find_model(options.model)
    requests = read_requests(options.config, defaults={"also": options.also})
    check_organs(model, {request.name: request.options for request in requests})
    _check_requests(requests)
    landmarks = {} if options.landmarks is None else read_landmarks(options.landmarks)
    check_names(model, landmarks)
    given = [path for path in (options.model, options.landmarks) if path is not None and path not in MODELS]
    fit_to_folder(
        options.image,
        requests,
        options.output,
        series=options.series,
        frame=options.frame,
        inputs=[options.config, *files_of(requests), *given],
        pictures=not options.no_pictures,
        fit_model=partial(_fitted, model=model, path=options.model, landmarks=landmarks),
    )


def _check_requests(requests: Sequence[OrganRequest]) -> None:
    """Refuse boundary points, which only a fit of single organs uses."""
    for request in requests:
        if request.boundary:
            msg = (
                f"{request.name}: boundary points were given, which model fit does not use. Leave the key boundary "
                "out, or fit the organ by itself."
            )
            raise ValueError(msg)


def _fitted(
    image: Image,
    separated: Sequence[Separated],
    stacks: Mapping[str, Stack],
    *,
    model: MultiPatchModel,
    path: str,
    landmarks: Mapping[str, np.ndarray],
) -> tuple[list[FittedOrgan], ModelResults]:
    """Fit the model to separated organs."""
    regions = {request.name: region for request, region, _ in separated}
    options = {request.name: request.options for request, _, _ in separated}
    further = {request.name: [stacks[path] for path in request.also] for request, _, _ in separated}
    steps = fit_model(image, model, regions, options, landmarks=landmarks, further=further)
    fit = finish(steps, on_step=stage_lines("model"))
    organs = []
    for request, _, seconds in separated:
        found = fit.organs[request.name]
        print_motions(request.name, found.stacks)
        organs.append(FittedOrgan(request, found, seconds + found.seconds, seconds))
    return organs, ModelResults(fit, path)
