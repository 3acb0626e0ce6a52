"""Whether a part that moves is named, and how it is shown, beside one frame interpolated.

python benchmarks/movement.py --seed 1000 --bursts 8

A part of 12 x 12 px moves evenly, by so many pixels from the first frame to the last, along a drawn
direction; the rest is still. Mosaics and parts of photographs, 4 frames on a square and 9 at random
places. Errors are those of the picture against the scene of the first frame, divided by those of
that frame interpolated, in the part that moves; and root mean squares in what stays. What changed
by less than three standard deviations of the noise is not counted as visible.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skimage import data
from skimage.color import rgb2gray
from skimage.transform import resize

from lensshift import Burst, reconstruct

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "reconstruction"))

from mosaic import MARGIN_PX, SAMPLES, canvas, square

SHAPE, SIDE_PX, SCALE, ROOM_PX = (29, 34), 12, 2, 6
SCENES = ("mosaic", "astronaut", "coins", "text")
Array = NDArray[np.float64]


def scene_of(name: str, rng: np.random.Generator) -> Array:
    """Return a scene on the fine grid of a mosaic, 0 .. 1."""
    if name == "mosaic":
        more = 2 * (ROOM_PX - MARGIN_PX)
        return canvas(rng, (SHAPE[0] + more, SHAPE[1] + more))
    image = getattr(data, name)()
    image = rgb2gray(image[..., :3]) if image.ndim == 3 else image / 255.0
    size = [3 * (n + 2 * ROOM_PX) for n in SHAPE]  # three samples of the photograph a pixel
    top, left = (rng.integers(0, max(n - s, 1)) for n, s in zip(image.shape, size, strict=True))
    part = image[top : top + size[0], left : left + size[1]]
    return np.asarray(resize(part, [n * SAMPLES // 3 for n in size], order=1))


def seen(scene: Array, offset_px: Array, scale: int = 1) -> Array:
    """Return what pixels see of the scene that moved by so much, to whole fine samples."""
    down, right = (round((ROOM_PX - d) * SAMPLES) for d in offset_px)
    rows, cols = SHAPE
    part = scene[down : down + rows * SAMPLES, right : right + cols * SAMPLES]
    side = SAMPLES // scale
    return part.reshape(rows * scale, side, cols * scale, side).mean(axis=(1, 3))


def burst_of(
    name: str, frames: int, snr: float, by_px: float, seed: int
) -> tuple[Burst, Array, tuple[slice, slice], bool]:
    """Return a burst, the truth of its first frame, where something moves and whether it shows."""
    rng = np.random.default_rng(seed)
    scene = scene_of(name, rng)
    offset_px = square(2) if frames == 4 else rng.uniform(-0.5, 0.5, (frames, 2))
    offset_px = np.round(offset_px * SAMPLES) / SAMPLES
    turn = rng.uniform(0, 2 * np.pi)
    step_px = by_px / (frames - 1) * np.array([np.sin(turn), np.cos(turn)])
    top, left = (rng.integers(3, n - SIDE_PX - 3) for n in SHAPE)
    place = slice(top, top + SIDE_PX), slice(left, left + SIDE_PX)
    still = np.stack([seen(scene, d) for d in offset_px])
    y = still.copy()
    for k, d in enumerate(offset_px):
        y[k][place] = seen(scene, d + k * step_px)[place]
    sigma = 0.8 / snr
    visible = bool(np.sqrt(np.mean((y - still)[-1][place] ** 2)) > 3 * sigma)
    y += rng.normal(0.0, sigma, y.shape)
    burst = Burst.from_arrays(y, offset_px=offset_px, pitch_mm=0.015)
    return burst, seen(scene, np.zeros(2), SCALE), place, visible


def main() -> None:
    """Print a line for each number of frames, signal-to-noise ratio and movement."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--bursts", type=int, default=4, help="of each scene and condition")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    print("frames SNR  px    named of visible   part / one frame: median, worst   rest, rms")
    for frames, snr, by_px in (
        (k, s, d) for k in (4, 9) for s in (30.0, 200.0) for d in (0, 0.5, 1, 2, 4)
    ):
        named, ratios, rest = [], [], []
        for number in range(args.bursts * len(SCENES)):
            name = SCENES[number % len(SCENES)]
            burst, truth, place, visible = burst_of(name, frames, snr, by_px, args.seed + number)
            found = reconstruct(burst, SCALE, std=False).amplitude
            alone = reconstruct(burst, SCALE, method="bicubic", frames=(0,), std=False).amplitude
            inside = np.zeros(truth.shape, bool)
            inside[tuple(slice(SCALE * p.start, SCALE * p.stop) for p in place)] = True
            square_error, one = ((e.image - truth) ** 2 for e in (found, alone))
            ratios.append(np.sqrt(square_error[inside].mean() / one[inside].mean()))
            rest.append(square_error[~inside].mean())
            named += [bool(found.notes.get("contradiction"))] if visible or not by_px else []
        print(
            f"{frames:4d} {snr:6.0f} {by_px:4.1f}  {sum(named):6d} of {len(named):3d}"
            f"   {np.median(ratios):18.2f} {max(ratios):8.2f}   {np.sqrt(np.mean(rest)):17.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
