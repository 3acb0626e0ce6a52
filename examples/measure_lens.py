"""A lens from ten photographs of a board of slanted squares: field, focus, a page, and the truth.

    python examples/measure_lens.py --out lens

The photographs are rendered: at each square the lens blurs with its own Gaussian, wider towards the
corners and across the radius than along it, and its focus is curved; 4:1 contrast, noise, gamma of
2.2, JPEG of quality 95. So the MTF of every edge is known. Prints how far MTF50 is off, how often
the 95 % interval holds it, and where the focus was found; writes lens.html and pictures.
"""

import argparse
import io
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import brentq

from lensshift import QualityWarning
from lensshift.evaluation.chart import ChartEdge
from lensshift.evaluation.chart_series import Photograph, focus_series, measure_chart
from lensshift.evaluation.levels import linear_light
from lensshift.report.chart import annotated_figure, chart_page
from lensshift.report.save import save_figure

Array = NDArray[np.float64]
TILES, TILE_PX, FINER = (3, 5), 120, 4
GAMMA, DARK, BRIGHT = 2.2, 0.18, 0.72
BEST_UM, CURVE_UM = 4.0, -12.0  # focus in the middle, and how much nearer it lies in the corners
PX_PER_UM = 0.06  # blur for each micrometre out of focus


def blur_px(height: float, focus_um: float) -> tuple[float, float]:
    """Return the widths of the blur along and across the radius at a place of the field."""
    away_um = focus_um - BEST_UM - CURVE_UM * height**2
    out = PX_PER_UM * away_um
    return float(np.hypot(0.45 + 0.35 * height**2, out)), float(np.hypot(0.45, out))


def photograph(focus_um: float, seed: int) -> Array:
    """Return the levels (8 bits) of a photograph."""
    rng = np.random.default_rng(seed)
    rows, cols = TILES
    light = np.empty((rows * TILE_PX, cols * TILE_PX))
    middle = 0.5 * np.array(light.shape)
    for i, j in np.ndindex(*TILES):
        centre = (np.array([i, j]) + 0.5) * TILE_PX
        away = centre - middle
        height = float(np.hypot(*away) / np.hypot(*middle))
        along, across = blur_px(height, focus_um)
        angle = np.arctan2(away[0], away[1])
        degrees = float(rng.choice([-1, 1]) * rng.uniform(4.0, 9.0))
        tile = square(degrees, along, across, angle)
        light[i * TILE_PX : (i + 1) * TILE_PX, j * TILE_PX : (j + 1) * TILE_PX] = tile
    light += 0.003 * rng.standard_normal(light.shape)
    levels = 255.0 * np.clip(light, 0.0, 1.0) ** (1.0 / GAMMA)
    stream = io.BytesIO()
    Image.fromarray(np.rint(levels).astype(np.uint8)).save(stream, "jpeg", quality=95)
    return np.asarray(Image.open(stream))


def square(degrees: float, along_px: float, across_px: float, angle_rad: float) -> Array:
    """Return a tile of light with a dark square, blurred by a turned Gaussian, seen by pixels.

    Exact in Fourier space: a drawn square has steps, whose quarter of a pixel is a blur of its own.
    """
    size, side = FINER * TILE_PX, 0.58 * TILE_PX
    turn = np.deg2rad(degrees)
    row, col = np.meshgrid(*2 * [np.fft.fftfreq(size, 1.0 / FINER)], indexing="ij")  # cycles/px
    u, v = (col * np.cos(turn) + row * np.sin(turn), row * np.cos(turn) - col * np.sin(turn))
    dark = side**2 * np.sinc(side * u) * np.sinc(side * v) * np.sinc(row) * np.sinc(col)
    radial = col * np.cos(angle_rad) + row * np.sin(angle_rad)
    round_ = row * np.cos(angle_rad) - col * np.sin(angle_rad)
    exponent = (along_px * radial) ** 2 + (across_px * round_) ** 2
    middle = np.exp(-1j * np.pi * (TILE_PX - 1) * (row + col))
    seen = dark * np.exp(-2.0 * np.pi**2 * exponent) * middle * FINER**2
    tile = BRIGHT - (BRIGHT - DARK) * np.fft.ifft2(seen).real
    return tile[::FINER, ::FINER]


def true_mtf50(edge: ChartEdge, focus_um: float) -> float:
    """Return the MTF50 in cycles per pixel along the normal of an edge: Gaussian and pixel."""
    place = (np.floor(np.array([edge.row_px, edge.col_px]) / TILE_PX) + 0.5) * TILE_PX
    middle = 0.5 * TILE_PX * np.array(TILES)
    away = place - middle
    along, across = blur_px(float(np.hypot(*away) / np.hypot(*middle)), focus_um)
    turn = edge.result.angle_rad.value
    normal = np.array([np.sin(turn), np.cos(turn)])  # (row, col)
    if edge.result.orientation == "horizontal":
        normal = normal[::-1]
    angle = np.arctan2(away[0], away[1])
    radial = float(normal @ [np.sin(angle), np.cos(angle)])
    sigma2 = (along * radial) ** 2 + across**2 * (1.0 - radial**2)

    def rest(frequency: float) -> float:
        gauss = np.exp(-2.0 * sigma2 * (np.pi * frequency) ** 2)
        return float(gauss * np.prod(np.sinc(frequency * normal)) - 0.5)

    return float(brentq(rest, 1e-4, 2.0))


def main() -> None:
    """Render, measure, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("lens"), help="folder for what is written")
    parser.add_argument("--photographs", type=int, default=10)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", QualityWarning)
    focus = np.linspace(-12.0, 15.0, asked.photographs)
    pictures = [
        Photograph(f"focus {at_um:+.0f} um", linear_light(photograph(at_um, k), GAMMA), at_um)
        for k, at_um in enumerate(focus)
    ]
    edges = measure_chart(pictures)
    used = [one for one in edges if one.result.usable]
    half = [one.result.mtf50_lpmm for one in used]
    true = np.array([true_mtf50(one, one.focus) for one in used])
    error = np.array([one.value for one in half]) / true - 1.0
    inside = [one.low <= value <= one.high for one, value in zip(half, true, strict=True)]
    print(f"{len(used)} of {15 * 4 * len(pictures)} edges used")
    print(f"MTF50 off by {100 * np.sqrt(np.mean(error**2)):.2f} % rms, ", end="")
    print(f"{100 * np.mean(inside):.0f} % within their 95 % interval")
    series, fits = focus_series(edges)
    for zone, fit in fits.items():
        print(f"best focus {zone}: {fit} um")
    page = chart_page(
        edges,
        [(one.name, one.first) for one in pictures],
        unit="cycles/px",
        series=series,
        fits=fits,
        focus_label="focus (um)",
    )
    page.save(asked.out / "lens.html")
    for one in pictures:
        here = [edge for edge in edges if edge.image == one.name]
        name = f"{one.name.replace(' ', '_')}.png"
        save_figure(annotated_figure(one.first, here, "cycles/px"), asked.out / name)
    print(f"wrote {asked.out / 'lens.html'}")


if __name__ == "__main__":
    main()
