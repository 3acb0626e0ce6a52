"""Photographs of two test charts, rendered, whose slanted edges are known: how many are found.

    python examples/charts.py --out charts

A board of 100 slanted squares, and stars of 4:1 contrast with frame, bar code, bars, patches and
marks around them, seen in perspective, blurred, with noise, saved as JPEG of quality 95. Writes the
pictures with the edges that were found and prints how many of the true ones are among them.
"""

import argparse
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter

from lensshift.evaluation.slanted_edge import find_regions

Points = NDArray[np.float64]
FINER = 4  # the chart is drawn so much finer than the pixels
QUALITY = 95


@dataclass(frozen=True)
class Chart:
    """A photograph [row col] in 0 .. 255, and the ends [edge 2 2] (x, y) of its slanted edges."""

    image: NDArray[np.float64]
    edges: Points


class Drawing:
    """Polygons on a sheet, seen in perspective by a camera."""

    def __init__(self, shape: tuple[int, int], rng: np.random.Generator) -> None:
        self.shape, self.rng, self.edges = shape, rng, []
        rows, cols = shape
        corners = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], float)
        self._matrix = homography(corners, corners + rng.uniform(-0.01, 0.01, (4, 2)) * cols)
        self._sheet = Image.new("L", (FINER * cols, FINER * rows), 200)
        self._pen = ImageDraw.Draw(self._sheet)

    def polygon(self, points: Points, grey: int, *, slanted: bool = False) -> None:
        """Fill a polygon [corner 2] (x, y); its sides are slanted edges of the chart if so told."""
        seen = self._seen(points)
        self._pen.polygon([tuple(FINER * (p + 0.5)) for p in seen], fill=grey)
        if slanted:
            self.edges += list(np.stack([seen, np.roll(seen, -1, axis=0)], axis=1))

    def _seen(self, points: Points) -> Points:
        whole = np.column_stack([points, np.ones(len(points))]) @ self._matrix.T
        return np.asarray(whole[:, :2] / whole[:, 2:])

    def photograph(self, blur_px: float, noise: float) -> Chart:
        """Return what a camera makes of the sheet; noise in grey levels."""
        fine = np.asarray(self._sheet, float)
        rows, cols = self.shape
        image = fine.reshape(rows, FINER, cols, FINER).mean(axis=(1, 3))
        image = gaussian_filter(image, blur_px) + noise * self.rng.standard_normal(self.shape)
        stream = io.BytesIO()
        Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(
            stream, "jpeg", quality=QUALITY
        )
        return Chart(np.asarray(Image.open(stream), float), np.array(self.edges))


def homography(source: Points, target: Points) -> Points:
    """Return the matrix [3 3] that takes four points to four others."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    solution = np.linalg.solve(np.array(rows), target.ravel())
    return np.append(solution, 1.0).reshape(3, 3)


def turned(points: Points, degrees: float, centre: tuple[float, float]) -> Points:
    """Return points turned about 0 and moved to a centre."""
    angle = np.deg2rad(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]) + centre)


def rectangle(x: float, y: float, width: float, height: float) -> Points:
    """Return the corners of an upright rectangle."""
    return np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])


def board(seed: int, shape: tuple[int, int] = (900, 1200)) -> Chart:
    """Return 100 dark squares, each turned by 5 degrees or so."""
    rng = np.random.default_rng(seed)
    drawing = Drawing(shape, rng)
    rows, cols = shape
    for i in range(10):
        for j in range(10):
            centre = ((j + 1) * cols / 11, (i + 1) * rows / 11)
            half = 0.27 * min(rows, cols) / 11 * 1.15
            square = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
            degrees = rng.choice([-1, 1]) * rng.uniform(5.0, 8.0)
            drawing.polygon(turned(square, degrees, centre), 40, slanted=True)
    return drawing.photograph(rng.uniform(0.6, 1.0), rng.uniform(1.0, 3.0))


def star_chart(seed: int, shape: tuple[int, int] = (1100, 1600)) -> Chart:
    """Return nine stars of 4:1 contrast among a frame, bars, a bar code, patches and marks."""
    rng = np.random.default_rng(seed)
    drawing = Drawing(shape, rng)
    rows, cols = shape
    for inset, grey in ((18, 10), (34, 200)):  # the frame, black as printers make it
        drawing.polygon(rectangle(inset, inset, cols - 2 * inset, rows - 2 * inset), grey)
    for i in range(3):
        for j in range(3):
            centre = ((j + 0.5) * cols / 3, (i + 0.5) * rows / 3)
            drawing.polygon(turned(rectangle(-110, -110, 220, 220), 0, centre), 160)
            # A square and its twin, an eighth of a turn apart, and both slanted by 5 degrees.
            side = 88.0
            square = side * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
            drawing.polygon(turned(square, 5.0 + rng.uniform(-1, 1), centre), 40, slanted=True)
    for k in range(24):  # a bar code, bars that grow finer, patches, marks
        drawing.polygon(rectangle(90 + 5 * k, 60, rng.integers(2, 4), 26), 10)
        width = 12 - 0.4 * k
        drawing.polygon(rectangle(cols / 3 - 18 + 0 * k, 60 + 38 * k, 36, width), 20)
    for k in range(9):
        drawing.polygon(rectangle(2 * cols / 3 - 18, 120 + 90 * k, 36, 60), 30 + 20 * k)
        x, y = (k + 0.5) * cols / 9, rows - 62
        for part in rng.uniform(-14, 14, (4, 2)):
            drawing.polygon(rectangle(x + part[0], y + 0.6 * part[1], 9, 3), 10)
            drawing.polygon(rectangle(x + part[0], y + 0.6 * part[1], 3, 9), 10)
    return drawing.photograph(rng.uniform(0.6, 1.0), rng.uniform(1.0, 3.0))


def score(chart: Chart) -> tuple[int, int, int]:
    """Return how many true edges were found, how many there are, and how many found are none."""
    seen, false = set(), 0
    for region in find_regions(chart.image):
        middle = np.array([region.col_start + region.col_stop, region.row_start + region.row_stop])
        middle = 0.5 * (middle - 1.0)
        ends = chart.edges
        along = ends[:, 1] - ends[:, 0]
        length = np.hypot(*along.T)
        place = np.sum((middle - ends[:, 0]) * along, axis=1) / length**2
        away = np.hypot(*(middle - ends[:, 0] - place[:, None] * along).T)
        best = int(np.argmin(np.where((place > 0.1) & (place < 0.9), away, np.inf)))
        rows, cols = region.row_stop - region.row_start, region.col_stop - region.col_start
        if 0.1 < place[best] < 0.9 and away[best] < 0.5 * min(rows, cols):
            seen.add(best)
        else:
            false += 1
    return len(seen), len(chart.edges), false


def annotated(chart: Chart) -> Image.Image:
    """Return the photograph with the regions that were found."""
    picture = Image.fromarray(chart.image.astype(np.uint8)).convert("RGB")
    pen = ImageDraw.Draw(picture)
    for region in find_regions(chart.image):
        box = [region.col_start, region.row_start, region.col_stop, region.row_stop]
        pen.rectangle(box, outline=(220, 60, 40), width=2)
    return picture


def main() -> None:
    """Draw both charts a few times, look for edges, and save what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("charts"), help="folder for the pictures")
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, make in (("board", board), ("stars", star_chart)):
        for seed in range(arguments.seeds):
            chart = make(seed)
            found, there, false = score(chart)
            print(f"{name} {seed}: {found} of {there} edges found, {false} others")
            annotated(chart).save(arguments.out / f"{name}_{seed}.png")


if __name__ == "__main__":
    main()
