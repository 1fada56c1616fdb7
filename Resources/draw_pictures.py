"""Draw the pictures that README and the pages show: of the demo, its report, and the generic model.

Needs what the demo needs, and Chromium for the report's picture.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from PIL import Image

import VICRegistrationLib as vic
from VICRegistrationLib import cli, demo
from VICRegistrationLib.analysis.comparison import distances_from
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.phantoms.stacks import further_stacks
from VICRegistrationLib.report.contents import fine_mesh
from VICRegistrationLib.report.figure import axes_at, blank_figure, save_figure
from VICRegistrationLib.report.scene import FRONT, OPPOSITE, USUAL, Shape, draw_scene

FOLDER = Path(__file__).resolve().parent
WIDTH = 1200
LANCZOS = Image.Resampling.LANCZOS
# Of the report as a browser shows it: its width, and where three parts of it begin, each as high as the last number.
PAGE_WIDTH, PARTS, PART_HEIGHT = 1000, (0, 1412, 2680), 1172


def main() -> None:
    """Run the demo in a folder that goes, and write the pictures into Resources."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        demo.run_demo(folder)
        organs = folder / "organs"
        truth = folder / "phantom" / "truth" / "bladder.json"
        cli.main(["model", "show", "--output", str(folder / "model.png")])
        cli.main(["compare", str(organs / "bladder.json"), str(truth), "--output", str(folder / "compared")])
        draw_stacks(folder / "stacks.png")
        for name, path in (
            ("several_stacks", folder / "stacks.png"),
            ("demo_overview", organs / "overview.png"),
            ("demo_rectum", organs / "rectum.png"),
            ("demo_deviation", folder / "compared" / "bladder_deviation.png"),
            ("demo_mesh", folder / "mesh" / "organs.png"),
            ("generic_model", folder / "model.png"),
        ):
            write_small(Image.open(path), name)
        browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        if browser is None:
            sys.exit("report.png is not drawn: that needs Chromium.")
        write_small(page_parts(browser, organs / "report.html", folder / "page.png"), "report", width=1800)


def draw_stacks(path: Path) -> None:
    """Draw the demo's rectum, fitted to one stack and to three, in the colours of its distance from the truth."""
    first = pelvis_phantom()
    stacks = further_stacks(2, shift_mm=3.0, turn_degrees=2.0)
    truth = first.surfaces["rectum"]
    figure = blank_figure(9.0, 6.9)
    for row, count in enumerate((0, 2)):
        fit = vic.fit(first.image, first.seeds["rectum"], further=[stack.image for stack in stacks[:count]])
        mesh = fine_mesh(fit.surface)
        distances = distances_from(truth, mesh.points)
        colours = colormaps["coolwarm"](Normalize(-0.6, 0.6)(distances))[:, :3]
        shape, bottom = Shape(mesh.points, mesh.triangles, colours, mesh.normals), 0.3 + 3.3 * (1 - row)
        for column, viewpoint in enumerate((USUAL, FRONT, OPPOSITE)):
            draw_scene(axes_at(figure, 2.0 + 2.3 * column, bottom, 2.2, 3.1), [shape], viewpoint)
        name = "sagittal stack" if not count else "sagittal, axial\nand coronal stack,\nthe last two moved\nby 3 mm, 2°"
        away = np.abs(distances)
        text = f"{name}\n\nmean {away.mean():.2f} mm\n95 %  {np.quantile(away, 0.95):.2f} mm"
        figure.text(0.02, (bottom + 1.6) / 6.9, text, size=11, va="center")
    note = "blue: inside of the true surface, red: outside; full colour: 0.6 mm"
    figure.text(0.5, 0.008, note, size=9, ha="center", va="bottom")
    save_figure(figure, path)


def page_parts(browser: str, page: Path, picture: Path) -> Image.Image:
    """Parts of a page as a browser shows it, side by side."""
    # Newer versions of Chromium show less of the page than the window is high.
    size = f"--window-size={PAGE_WIDTH},{PARTS[-1] + PART_HEIGHT + 200}"
    how = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", size, f"--screenshot={picture}"]
    subprocess.run([browser, *how, page.as_uri()], check=True, capture_output=True)
    whole, gap = Image.open(picture).convert("RGB"), 12
    parts = Image.new("RGB", (len(PARTS) * (PAGE_WIDTH + gap) + gap, PART_HEIGHT + 2 * gap), "#20242b")
    for number, top in enumerate(PARTS):
        part = whole.crop((0, top, PAGE_WIDTH, top + PART_HEIGHT))
        parts.paste(part, (gap + number * (PAGE_WIDTH + gap), gap))
    return parts


def write_small(picture: Image.Image, name: str, *, width: int = WIDTH) -> None:
    """Write a picture with fewer pixels and 256 colours, which neighbouring pixels mix so that shading stays smooth."""
    small = picture.convert("RGB").resize((width, round(picture.height * width / picture.width)), LANCZOS)
    palette = small.quantize(256, method=Image.Quantize.MAXCOVERAGE)
    path = FOLDER / f"{name}.png"
    small.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
