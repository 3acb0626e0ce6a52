"""Shifts that are off from where they were told: what the frames make of them, and the picture.

python benchmarks/told_shifts.py --seed 400 --bursts 4
python benchmarks/told_shifts.py --seed 400 --bursts 8 --upright

Cards, waves and parts of photographs, seen by square pixels at the very shifts (8 x 8 points in a
pixel, 64 x 64 where scenes are upright, whose edges move by whole steps of these), with four frames
on a square and nine at random places; each shift is off by a normal error that nobody told. A line
for each error: that of the shifts about their mean before and after, how often they were mended and
named, the gain of the picture over shifts that are believed (told to be exact), and what 2 std hold
of the truth. For each number of frames, level of noise and scene. Upright scenes (boxes, checkers,
crosses) have edges along the pixels alone, and shifts that were told right.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from skimage import data
from skimage.color import rgb2gray

from lensshift import Burst, reconstruct

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "reconstruction"))

from pixel_camera import FINE, SQUARE_PX, interior_psnr, photograph

SHAPE = (27, 34)
ERRORS_PX = (0.0, 0.02, 0.05, 0.1)
SNRS = (15, 50, 200)
PHOTOGRAPHS = ("astronaut", "coins", "grass", "page")
Array = NDArray[np.float64]
Scene = Callable[[Array, Array], Array]


def cards(rng: np.random.Generator) -> Scene:
    """Return turned cards of several sizes and tones, one before the other."""
    parts = rng.uniform((0, 0, 1.5, 1.5, 0, 0.1), (*SHAPE, 6, 6, np.pi, 0.9), (25, 6))

    def at(row: Array, col: Array) -> Array:
        found = np.full(np.broadcast(row, col).shape, 0.3)
        for y, x, half, wide, turn, tone in parts:
            across = (row - y) * np.cos(turn) + (col - x) * np.sin(turn)
            along = (col - x) * np.cos(turn) - (row - y) * np.sin(turn)
            found = np.where((np.abs(across) < half) & (np.abs(along) < wide), tone, found)
        return found

    return at


def waves(rng: np.random.Generator) -> Scene:
    """Return waves up to 0.9 cycles per LR pixel, finer ones fainter."""
    turn, phase = rng.uniform(0, 2 * np.pi, (2, 40))
    frequency = 0.9 * np.sqrt(rng.uniform(0.003, 1, 40))
    size = frequency ** -rng.uniform(0, 1.5)
    size *= 0.2 / np.sqrt(np.sum(size**2))

    def at(row: Array, col: Array) -> Array:
        found = np.full(np.broadcast(row, col).shape, 0.5)
        for f, a, b, s in zip(frequency, turn, phase, size, strict=True):
            found += s * np.cos(2 * np.pi * f * (row * np.sin(a) + col * np.cos(a)) + b)
        return found

    return at


def picture(rng: np.random.Generator) -> Scene:
    """Return a part of a photograph or of a page, three samples in a pixel."""
    image = getattr(data, str(rng.choice(PHOTOGRAPHS)))()
    image = rgb2gray(image) if image.ndim == 3 else image / 255.0
    room = [n - 3 * (m + 4) for n, m in zip(image.shape, SHAPE, strict=True)]
    top, left = (int(rng.integers(0, n)) + 6 for n in room)

    def at(row: Array, col: Array) -> Array:
        places = np.broadcast_arrays(top + 3 * row, left + 3 * col)
        return np.asarray(map_coordinates(image, places, order=1, mode="nearest"))

    return at


def boxes(rng: np.random.Generator) -> Scene:
    """Return upright boxes, one to twelve, one before the other."""
    parts = rng.uniform((0, 0, 1, 1, 0.1), (*SHAPE, 8, 8, 0.9), (int(rng.integers(1, 13)), 5))

    def at(row: Array, col: Array) -> Array:
        found = np.full(np.broadcast(row, col).shape, 0.3)
        for y, x, half, wide, tone in parts:
            found = np.where((np.abs(row - y) < half) & (np.abs(col - x) < wide), tone, found)
        return found

    return at


def checker(rng: np.random.Generator) -> Scene:
    """Return an upright checker of 2 to 7 px."""
    size, top, left = rng.uniform((2, 0, 0), 7)
    return lambda row, col: (
        0.2 + 0.6 * ((np.floor((row - top) / size) + np.floor((col - left) / size)) % 2)
    )


def cross(rng: np.random.Generator) -> Scene:
    """Return an upright cross, its bars 0.6 to 4 px wide, and nothing else."""
    y, x, half = rng.uniform((9, 9, 0.3), (18, 24, 2))
    return lambda row, col: np.where((np.abs(row - y) < half) | (np.abs(col - x) < half), 0.8, 0.2)


SCENES = {"cards": cards, "waves": waves, "picture": picture}
UPRIGHT = {"boxes": boxes, "checker": checker, "cross": cross}


def judged(burst: Burst, truth: Array) -> tuple[float, float, dict[str, object], bool]:
    """Return PSNR, share of the truth within 2 std, what is said of the shifts, and if aloud."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = reconstruct(burst, 2, psf_sigma_px=0.3)
    image = found.amplitude
    inner = (slice(4, -4), slice(4, -4))
    inside = float(np.mean((np.abs(image.image - truth) < 2 * image.std)[inner]))
    said = any("offset_px is off" in str(one.message) for one in caught)
    return interior_psnr(image.image, truth), inside, found.settings, said


def one(name: str, frames: int, snr: float, error_px: float, seed: int) -> list[float]:
    """Return what a line is the mean of."""
    rng = np.random.default_rng(seed)
    scene = (SCENES | UPRIGHT)[name](rng)
    told_px = SQUARE_PX if frames == 4 else rng.uniform(-0.5, 0.5, (frames, 2))
    wrong_px = error_px * rng.standard_normal(told_px.shape)
    wrong_px -= wrong_px.mean(axis=0)  # which moves the picture, no more
    fine = 64 if name in UPRIGHT else FINE
    y = photograph(scene, SHAPE, told_px + wrong_px, fine=fine)
    y += rng.normal(0.0, 0.8 / snr, y.shape)
    truth = photograph(scene, SHAPE, (0.0, 0.0), 2, fine)[0]
    asked = Burst.from_arrays(y, offset_px=told_px, pitch_mm=0.015)
    exact = Burst.from_arrays(
        y, offset_px=told_px, pitch_mm=0.015, offset_sigma_px=np.zeros_like(told_px)
    )
    before, inside_before, _, _ = judged(exact, truth)
    after, inside, settings, said = judged(asked, truth)
    mended_px = np.array(settings.get("corrected_offset_px", told_px))
    left_px = mended_px - told_px - wrong_px
    mended = "corrected_offset_px" in settings
    return [np.mean(wrong_px**2), np.mean(left_px**2), mended, said, after - before,
            inside_before, inside]  # fmt: skip


def print_lines(seed: int, bursts: int, names: Iterable[str], errors_px: Sequence[float]) -> None:
    """Print a line for each error and number of frames."""
    sys.stdout.write(
        "error px  frames  off px: told   left  mended  named  gain dB: mean  least  "
        "2 std before  after\n"
    )
    for error_px in errors_px:
        for frames in (4, 9):
            rows = np.array([
                one(name, frames, snr, error_px, seed + number)
                for number in range(bursts)
                for name in names
                for snr in SNRS
            ])  # fmt: skip
            told, left, mended, said, gain, before, after = rows.mean(axis=0)
            sys.stdout.write(
                f"{error_px:8.2f} {frames:7d} {told**0.5:13.4f} {left**0.5:6.4f} {mended:7.2f} "
                f"{said:6.2f} {gain:14.2f} {rows[:, 4].min():6.2f} {before:13.3f} {after:6.3f}\n"
            )
            sys.stdout.flush()


def main() -> None:
    """Print the lines, of upright scenes for each kind."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--seed", type=int, default=400)
    ask.add_argument("--bursts", type=int, default=4, help="of each scene, noise and frame count")
    ask.add_argument("--upright", action="store_true", help="scenes with edges along the pixels")
    given = ask.parse_args()
    names, errors_px = (UPRIGHT, (0.0,)) if given.upright else (SCENES, ERRORS_PX)
    for part in ([name] for name in names) if given.upright else (names,):
        sys.stdout.write(f"{', '.join(part)}\n")
        print_lines(given.seed, given.bursts, part, errors_px)


if __name__ == "__main__":
    main()
