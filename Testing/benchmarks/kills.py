"""Fits that are killed at random moments: ``python Testing/benchmarks/kills.py``.

Two organs are fitted again, with another net and with their exact solids, into a folder that holds results, and the
process is ended at a random moment. The folder must hold all old results or all new ones, and the user's file. Ends
with 0 if it always does.
"""

from __future__ import annotations

import argparse
import collections
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "VICRegistration"), str(ROOT / "Testing" / "Python")]
# Before numpy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
OLD_NET, NEW_NET = "7x6", "8x7"
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


def prepared(base: Path) -> list[str]:
    """Write an image of one organ and a configuration of two; returns the words of the fit."""
    from small_phantom import CENTER, ellipsoid_image

    from VICRegistrationLib.imaging.reading import write_image

    write_image(ellipsoid_image(), base / "mri.nrrd")
    organs = [{"organ": name, "seed": CENTER.tolist()} for name in ("bladder", "rectum")]
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    (base / "organs.json").write_text(json.dumps(content))
    return ["fit", str(base / "mri.nrrd"), "--config", str(base / "organs.json"), "--quiet", "--step"]


def started(words: list[str]) -> int:
    """Run a command in a process of its own; returns its number."""
    child = os.fork()
    if child:
        return child
    from VICRegistrationLib import cli

    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    os._exit(cli.main(words))
    return 0


def ended(child: int) -> int:
    """Wait for a process; returns its exit code, or minus the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def state(folder: Path) -> str:
    """Say what a folder holds: "old", "new", or what is wrong with it."""
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    files = dict(report["files"])
    for organ in report["organs"].values():
        files.update(organ["files"])
    wrong = [name for name, digest in files.items() if digest_of(folder / name) != digest]
    if wrong:
        return f"not as the report says: {', '.join(wrong)}"
    found = {path.name for path in folder.iterdir() if not path.name.startswith(".vic-")}
    if found != {"report.json", "notes.txt", *files}:
        return f"missing or left over: {', '.join(sorted(found ^ {'report.json', 'notes.txt', *files}))}"
    nets = {organ["net"] for organ in report["organs"].values()}
    if len(report["organs"]) != 2 or len(nets) != 1 or {"bladder.step", "rectum.step", "organs.step"} - found:
        return f"organs {list(report['organs'])} with nets {nets}"
    return {OLD_NET: "old", NEW_NET: "new"}[nets.pop()]


def digest_of(path: Path) -> str:
    """SHA-256 of a file; empty if it is not there."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def killed(words: list[str], old: Path, folder: Path, delay: float, number: int) -> tuple[int, str, str]:
    """Fit into a copy of a folder and end that after `delay` s; returns exit code, states before and after recovery."""
    from VICRegistrationLib.transactions import recover

    shutil.copytree(old, folder)
    child = started([*words, "--net", NEW_NET, "--output", str(folder)])
    time.sleep(delay)
    os.kill(child, number)
    code = ended(child)
    before = "half" if any(folder.glob(".vic-*/journal.json")) else state(folder)
    recover(folder)
    return code, before, state(folder)


def report(*, quick: bool) -> str:
    """Run this file as a program, as it ends processes, and give what it prints."""
    done = subprocess.run(
        [sys.executable, __file__, "--moments", "10" if quick else "100"], stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout.rstrip()


def main() -> int:
    """Kill fits and print what they left."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--pictures", action="store_true", help="draw pictures and the page too, which takes longer")
    parser.add_argument("--random", type=int, default=0, help="where the random numbers begin")
    options = parser.parse_args()
    moments = random.Random(options.random)
    outcomes, wrong = collections.Counter(), []
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        words = [*prepared(base), *([] if options.pictures else ["--no-pictures"])]
        old = base / "old"
        assert ended(started([*words, "--net", OLD_NET, "--output", str(old)])) == 0
        (old / "notes.txt").write_text("mine")
        shutil.copytree(old, base / "whole")
        start = time.perf_counter()
        assert ended(started([*words, "--net", NEW_NET, "--output", str(base / "whole")])) == 0
        seconds = time.perf_counter() - start
        assert (state(old), state(base / "whole")) == ("old", "new")
        for moment in range(options.moments):
            delay, number = moments.uniform(0.0, 1.05 * seconds), moments.choice(SIGNALS)
            code, before, after = killed(words, old, base / str(moment), delay, number)
            outcomes[before, after] += 1
            if after not in ("old", "new") or (base / str(moment) / "notes.txt").read_text() != "mine":
                wrong.append(f"signal {number} after {delay:.3f} s, exit code {code}: {after}")
            shutil.rmtree(base / str(moment))
    print(f"{options.moments} fits of about {seconds:.2f} s, ended at random moments:\n")
    for (before, after), count in sorted(outcomes.items()):
        print(f"- {count} left {before} results, after recovery {after}")
    totals = (sum(count for (_, after), count in outcomes.items() if after == kind) for kind in ("old", "new"))
    print("\nIn all {} ended with the old results, {} with the new ones.".format(*totals))
    print("\n".join(wrong))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
