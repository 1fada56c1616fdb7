"""Runs of the command `fit` into a folder of results, and what is in it then, for tests of such folders."""

from __future__ import annotations

import json

from small_phantom import SEED

from VICRegistrationLib import cli
from VICRegistrationLib.cli.stored_results import file_digest

OTHER_SEED = "-10,10,-18"


def fit(image, organ, output, *more, seed=SEED):
    words = ["fit", image, "--organ", organ, "--seed", seed, "--output", output, "--quiet", *more]
    return cli.main([str(word) for word in words])


def report(folder):
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def check_report(folder, *, others=("notes.txt",)):
    """All files that the report names are there as they were written, and no others but the user's."""
    found = report(folder)
    files = {
        **found["files"],
        **{name: file for organ in found["organs"].values() for name, file in organ["files"].items()},
    }
    assert {name: file_digest(folder / name) for name in files} == files
    assert {path.name for path in folder.iterdir()} == {"report.json", *files, *others}
    return found


def configuration(tmp_path, *organs):
    path = tmp_path / "organs.json"
    path.write_text(json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": organs}))
    return path


def refer(folder, organ, reference):
    """Write into the report what an organ was compared with."""
    content = report(folder)
    content["organs"][organ]["reference"] = reference
    del content["digest"]
    (folder / "report.json").write_text(json.dumps(content))
