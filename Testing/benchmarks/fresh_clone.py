"""Minutes and disk space of the README's two commands in a fresh clone."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measuring import table

ROOT = Path(__file__).resolve().parents[2]
TARGETS = ("demo", "test")


def report(*, quick: bool) -> str:
    """Run `make demo` and `make test` one after the other in a clone that is removed afterwards."""
    rows, ends = [["command", "minutes", "GB of disk afterwards"]], []
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder, "clone")
        subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
        outside = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "OMP_NUM_THREADS")}
        for target in TARGETS[: 1 if quick else None]:
            start = time.perf_counter()
            command = ["make", target, f"PYTHON={sys.executable}"]
            done = subprocess.run(command, cwd=clone, env=outside, stdout=subprocess.PIPE, text=True)
            if done.returncode and target == "demo":
                message = f"make {target} ended with {done.returncode}:\n{done.stdout[-2000:]}"
                raise RuntimeError(message)
            minutes = f"{(time.perf_counter() - start) / 60.0:.1f}"
            rows.append([f"make {target}", minutes, f"{size_of(clone) / 1e9:.1f}"])
            last = done.stdout.strip().rpartition("\n")[2].replace(str(clone), ".")
            # A record that says "skipped" is not written; a clone has no data of patients beside it.
            ends.append(f"  `make {target}` ends with: {last.replace('skipped', 'need data that a clone lacks')}")
    return "\n\n".join(["  One after the other, on all cores, packages from the network.", table(rows), *ends])


def size_of(folder: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir())
