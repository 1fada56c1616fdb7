"""Figures of the pages: what each command printed is kept in docs/measured, and the pages are checked against it.

``python Testing/benchmarks/records.py`` copies the tables of the records into the pages and lists the figures that no
record has. ``python Testing/benchmarks/run.py --only NAME --write`` measures anew, and then does the same.
"""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RECORDS = ROOT / "docs" / "measured"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "docs" / "examples" / "README.md")

# Numbers that nobody has measured: settings of the program, of formats, and of the images that were taken.
SETTINGS = {
    "README.md": "slices of 4 and 1 mm; licence 2.0; Slicer 5.8",
    "docs/architecture.md": "slices of 50 ms of the event loop",
    "docs/changes.md": "common volume 1 %, 0.3 mm; no edge 4 %; labels 0.001, pieces 0.5 %; "
    "tau 0.01, erosion and others 20 mm",
    "docs/command-line.md": "exit codes 130, 143, 141; seeds 4 mm; triangles 0.05 mm; no edge 4 %; "
    "standard error 0.005; volumes 0.001; Jacobians of 1 and 0",
    "docs/development.md": "pictures of 250 kB",
    "docs/file-formats.md": "never 1 mm; positions 0.1 mm; pixdim 1 %; qform 0.5 mm; axes 0.2 degrees; labels 0.001; "
    "corners 1e-6; verdict 1.5 mm; cost 0.3 %; in cm: 60, 0.15 mm",
    "docs/generic-model.md": "sheets of 3 and 2.5 mm, in the literature 2.9, 0.8, 2.2 to 2.8, 1.2 to 1.7 mm; "
    "0 degrees but for rounding; elements 3 mm; Jacobian 0.1; "
    "basis functions 80 mm; turned 45 degrees; landmarks 30 mm; determinant 0.1",
    "docs/method.md": "slices of 4 mm; pixels 2 to 3; bent by 1.2 half widths; the paper's 0.01 and 9 x 7",
    "docs/several-stacks.md": "refused beyond 15 mm, 15 degrees; edges apart by 0.35 mm, 0.55 pixels, on the mean "
    "by 0.2 mm, 0.27 pixels",
    "docs/tutorial.md": "95 %",
    "docs/validation.md": "bell 50 mm in 100 mm, smoothing 0.5 mm and factor 0.5; 10,000 points; pixels 0.59, 0.5 mm, "
    "slices 4 and 1 mm, noise 5 %, coil 20 %, blur 2 mm; seeds 1 to 3, levels 15 %; no edge 3 mm; normally 95.4 %; "
    "level of a layer 0.2 mm from a plane; gap 16 mm, signal 35, 50 %",
    "docs/examples/README.md": "foundation 1e-6",
}

_NUMBER = r"(?<![\w.^-])\d[\d,]*(?:\.\d+)?(?:e-?\d+)?(?![\w²³]|[.-]\w)"
_UNIT = r"(?= ?(?:mm|ml|%|s|ms|times|minutes|GB|MB|kB|kPa|µJ|degrees|°)(?!\w))"
# What names a number that is no figure.
_NAMED = re.compile(
    r"(?:\b(?:figures?|tables?|equations?|sections?|chapter|steps?|Python|Slicer|format|version|NIfTI|AP)|[(]C) "
    r"?[\d.]+(?:(?:,| and| to) [\d.]+)*"
)
_TABLE = re.compile(r"^<!-- table: (\w+), (.+?) -->\n(?:\|.*\n)*", re.MULTILINE)
# A heading begins a piece, and so does an item of a list.
_PIECE = re.compile(r"^(?=#+ |[-*] |\d+\. )", re.MULTILINE)
_SOURCE = re.compile(r"--only (\w+)|make (reproduce)|/?(test_\w+\.py)")


def write_record(name: str, title: str, machine: str, text: str) -> Path:
    """Keep what a benchmark printed.

    Raises
    ------
    ValueError
        If data or programs were missing, so that the record would lack what the pages cite.
    """
    missing = re.search(r".*(?:[Ss]kipped| absent|not here).*", text)
    if missing:
        message = f"{name}: nothing is written, because the run was not complete: {missing[0].strip()}"
        raise ValueError(message)
    RECORDS.mkdir(exist_ok=True)
    path = RECORDS / f"{name}.md"
    command = f"python Testing/benchmarks/run.py --only {name} --write"
    path.write_text(f"# {title}\n\nWritten by `{command}` on {machine}.\n\n{textwrap.dedent(text)}\n", encoding="utf-8")
    return path


def tables(name: str) -> dict[str, str]:
    """Tables of a record, by the first cell of their title."""
    path = RECORDS / f"{name}.md"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    found = re.findall(r"^\|.*\n(?:\|.*\n)+", text + "\n", re.MULTILINE)
    return {table.split("|")[1].strip(): table for table in found}


def renewed(text: str) -> tuple[str, list[str]]:
    """Text of a page with the tables of the records below their marks, and sentences about marks without one.

    A mark is ``<!-- table: NAME, FIRST CELL -->``.
    """
    missing = []

    def table(mark: re.Match) -> str:
        known = tables(mark[1])
        if mark[2] in known:
            return f"<!-- table: {mark[1]}, {mark[2]} -->\n{known[mark[2]]}"
        has = ", ".join(map(repr, known)) or "none"
        missing.append(f"docs/measured/{mark[1]}.md has no table {mark[2]!r}, but {has}")
        return mark[0]

    return _TABLE.sub(table, text), missing


def numbers(text: str, *, unit: bool = False) -> Iterator[tuple[str, float]]:
    """Numbers as written, and their values; with `unit` only those with a decimal point or a unit."""
    for match in re.finditer(_NUMBER, text):
        word = match[0].rstrip(",")
        if not unit or "." in word or "e" in word or re.match(_UNIT, text[match.start() + len(word) :]):
            yield word, float(word.replace(",", ""))


def unsupported(page: Path) -> list[str]:
    """Figures of a page that no command beside them has printed, a sentence each."""
    name = page.relative_to(ROOT).as_posix()
    given = {value for _, value in numbers(SETTINGS.get(name, ""))}
    found = []
    for piece in _PIECE.split(_prose(page.read_text(encoding="utf-8"))):
        sources = sorted({next(filter(None, match)) for match in _SOURCE.findall(piece)})
        known = given.union(*(_known(source) for source in sources))
        wrong = [word for word, value in numbers(_plain(piece), unit=not sources) if value not in known]
        if wrong:
            where = f"not printed by {', '.join(sources)}" if sources else "no command is named beside it"
            found.append(f"{name}: {', '.join(wrong)}: {where}: {' '.join(piece.split())[:100]}")
    return found


def outdated(page: Path) -> list[str]:
    """Numbers of `SETTINGS` that their page does not have any more."""
    there = {value for _, value in numbers(_plain(_prose(page.read_text(encoding="utf-8"))))}
    given = SETTINGS.get(page.relative_to(ROOT).as_posix(), "")
    return [word for word, value in numbers(given) if value not in there]


def _prose(text: str) -> str:
    """Text without code, tables of records and rows of options, which other tests check."""
    text = re.sub(r"^ *```.*?^ *```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"^ {4}.*|^\| `--.*", "", _TABLE.sub("", text), flags=re.MULTILINE)


def _plain(text: str) -> str:
    """Text without inline code, addresses and numbers that are names."""
    return _NAMED.sub("", re.sub(r"`[^`]*`|\]\([^)]*\)|<[^>]*>", "", text))


def _known(source: str) -> set[float]:
    path = ROOT / "Testing" / "Python" / source if source.endswith(".py") else RECORDS / f"{source}.md"
    return {value for _, value in numbers(path.read_text(encoding="utf-8"))} if path.exists() else set()


def main() -> int:
    """Renew the tables of all pages, and list figures without a record."""
    wrong = []
    for page in PAGES:
        text, missing = renewed(page.read_text(encoding="utf-8"))
        page.write_text(text, encoding="utf-8")
        wrong += missing + unsupported(page)
    print("\n".join(wrong) if wrong else "All figures of the pages are in docs/measured.")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
