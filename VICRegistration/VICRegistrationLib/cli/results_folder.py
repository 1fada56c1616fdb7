"""Writing the organs of a run into the folder of results of its image, beside those of earlier runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..files import replacing_folder
from ..imaging.image import Image
from ..transactions import one_at_a_time
from .console import LOG
from .model_results import model_files
from .organ_entries import FittedOrgan, Run, restored_organ
from .outputs import organ_files, run_entry, write_organ, write_report, write_solids
from .references import OrganReference, read_again
from .report_page import write_pictures
from .stored_results import ASSEMBLY, OVERVIEW, PAGE, REPORT, StoredResults, read_results


def target_files(names: Sequence[str], *, pictures: bool, step: bool, model: bool = False) -> list[str]:
    """Names of all files that a run may write.

    Parameters
    ----------
    names : sequence of str
        Of its organs.
    pictures, step : bool
    model : bool
        Whether they are fitted with a generic model.

    Returns
    -------
    list of str
    """
    own = [file for name in names for file in organ_files(name, pictures=pictures, solid=step)]
    own += model_files(pictures=pictures) if model else []
    return [*own, *([PAGE, OVERVIEW] if pictures else []), *([ASSEMBLY] if step else []), REPORT]


def restored_organs(stored: StoredResults, names: Sequence[str], image: Image) -> dict[str, FittedOrgan]:
    """Restore the organs of earlier runs that stay.

    Parameters
    ----------
    stored : StoredResults
    names : sequence of str
        Of the organs of this run.
    image : Image

    Returns
    -------
    dict of str to FittedOrgan

    Raises
    ------
    ValueError
        If one cannot be read again.
    """
    others = {name: entry for name, entry in stored.organs.items() if name not in names}
    return {name: restored_organ(name, entry, stored.folder, image) for name, entry in others.items()}


def write_results(run: Run, folder: Path) -> None:
    """Add the organs of a run to a folder of results, or replace them in it: all files or none.

    Parameters
    ----------
    run : Run
    folder : Path
        Made if it does not exist.

    Raises
    ------
    ValueError
        If the folder holds results of another image, or a file that is no result would be replaced.
    OSError
        If a file cannot be written.
    """
    waiting = f"waiting for another run that writes into {folder}"
    with one_at_a_time(folder, on_wait=lambda: LOG.info(waiting)):
        # Another run may have added organs while this one was fitting.
        stored = read_results(folder)
        stored.check_image(run.record)
        stored.check_targets(target_files(run.names, pictures=run.pictures, step=run.step, model=run.model is not None))
        outdated: list[str] = []
        with replacing_folder(folder, outdated=outdated) as drafts:
            _write_drafts(run, stored, drafts)
            outdated += _outdated(run, stored, drafts)
    _warn_of_removed(run, stored, outdated)
    kept = ", ".join(name for name in stored.organs if name not in run.names)
    names = [*run.names, *(["the model"] if run.model is not None else [])]
    LOG.info(f"written to {folder}: {', '.join(names)}" + (f"; kept from earlier runs: {kept}" if kept else ""))


def _write_drafts(run: Run, stored: StoredResults, drafts: Path) -> None:
    """Write the files of the run, and those that have all organs of the folder."""
    for organ in run.organs:
        write_organ(organ, drafts)
    names = [*stored.organs, *(name for name in run.names if name not in stored.organs)]
    everyone = []
    if run.pictures or run.step:
        found = {**restored_organs(stored, run.names, run.image), **{organ.name: organ for organ in run.organs}}
        everyone = [found[name] for name in names]
    solids = write_solids(everyone, drafts, names=run.names) if run.step else []
    own = {name: organ_files(name, pictures=run.pictures, solid=f"{name}.step" in solids) for name in run.names}
    files = {name: own.get(name) or list(stored.files_of(name)) for name in names}
    common = [ASSEMBLY] if ASSEMBLY in solids else []
    if run.model is not None:
        common += run.model.write(drafts, pictures=run.pictures)
    if run.pictures:
        common += [PAGE, *([OVERVIEW] if len(names) > 1 else [])]
        references = {**_stored_references(run, stored), **run.references}
        write_pictures(run, everyone, references, drafts, files=files, common=common)
    entries = {organ.name: run_entry(run, organ, drafts, files=own[organ.name]) for organ in run.organs}
    write_report(run, {name: entries.get(name) or stored.organs[name] for name in names}, drafts, files=common)


def _stored_references(run: Run, stored: StoredResults) -> dict[str, OrganReference]:
    """Read the references of earlier runs again."""
    found = {}
    for name, entry in stored.organs.items():
        if name in run.names or entry["reference"] is None:
            continue
        try:
            found[name] = read_again(name, entry["reference"])
        except (OSError, ValueError) as error:
            LOG.warning(
                f"{name}: warning: report.html does not show its reference, which cannot be read again: {error}"
            )
    return found


def _outdated(run: Run, stored: StoredResults, drafts: Path) -> list[str]:
    """Files of earlier runs that do not show the present surfaces."""
    organs = dict.fromkeys([*run.names, *stored.removed_organs])
    listed = [*stored.content.get("files", {}), *(file for name in organs for file in stored.files_of(name))]
    old = [name for name in listed if (stored.folder / name).is_file() and not (drafts / name).exists()]
    for name in old:
        if not stored.holds(name):
            LOG.warning(f"{stored.folder / name} is outdated, but is kept because it was changed since it was written")
    return [name for name in old if stored.holds(name)]


def _warn_of_removed(run: Run, stored: StoredResults, outdated: Sequence[str]) -> None:
    removed = ", ".join(name for name in stored.removed_organs if name not in run.names)
    if removed:
        LOG.warning(f"no longer in the report, because the surface was removed from {stored.folder}: {removed}")
    if outdated:
        LOG.warning(f"removed from {stored.folder} because outdated: {', '.join(outdated)}")
