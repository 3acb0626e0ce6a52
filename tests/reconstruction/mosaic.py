"""Bursts of mosaics: another generator of worlds than the one that trained the solver.

Cells around random points, each with a tone, a ramp or a wave; LR pixels are block means of a fine
canvas, so shifts are whole fine samples and the integral over the pixel is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SAMPLES = 12  # fine samples along an LR pixel
MARGIN_PX = 2


@dataclass(frozen=True)
class MosaicBurst:
    """Frames [frame row col], their offsets, the truth on the HR grid and the noise."""

    y: NDArray[np.float64]
    offset_px: NDArray[np.float64]
    truth: NDArray[np.float64]
    sigma: float
    scale: int


def square(scale: int) -> NDArray[np.float64]:
    """Return the pattern that puts every LR pixel on an HR pixel."""
    line = (np.arange(scale) - (scale - 1) / 2) / scale
    return np.array([(a, b) for a in line for b in line])


def canvas(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return a mosaic on the fine grid of frames of that shape, with its margin."""
    rows, cols = ((n + 2 * MARGIN_PX) * SAMPLES for n in shape)
    row, col = np.arange(rows)[:, None] / SAMPLES, np.arange(cols) / SAMPLES
    count = int(rng.integers(4, 25))
    points = rng.uniform(0, 1, (count, 2)) * (row.max(), col.max())
    nearest, least = np.zeros((rows, cols), int), np.full((rows, cols), np.inf)
    for cell, (down, right) in enumerate(points):
        away = (row - down) ** 2 + (col - right) ** 2
        nearest[away < least] = cell
        np.minimum(away, least, out=least)
    ground = np.zeros((rows, cols))
    for cell in range(count):
        turn, frequency = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.6)  # cycles per LR px
        kind, tone = rng.integers(4), rng.uniform(0.1, 0.9)
        inside = nearest == cell
        ground[inside] = tone
        if kind > 1:
            along = row * np.sin(turn) + col * np.cos(turn)
            ramp = 0.02 * (along[inside] - along.mean())
            wave = 0.2 * np.sin(2 * np.pi * frequency * along[inside])
            ground[inside] += ramp if kind == 2 else wave
    return ground


def observe(
    fine: NDArray[np.float64],
    shape: tuple[int, int],
    *,
    scale: int = 2,
    offset_px: NDArray[np.float64] | None = None,
    snr: float = 50.0,
    side: int = SAMPLES,
    rng: np.random.Generator,
) -> MosaicBurst:
    """Return the burst that a camera with square pixels takes of the canvas.

    The middle of a pixel is sensitive, so many fine samples wide (an even number).
    """
    offset = square(scale) if offset_px is None else offset_px
    sigma = 0.8 / snr
    frames = [_means(fine, shape, SAMPLES, np.rint(-o * SAMPLES).astype(int), side) for o in offset]
    y = np.stack(frames) + sigma * rng.standard_normal((len(offset), *shape))
    hr = (shape[0] * scale, shape[1] * scale)
    return MosaicBurst(
        y, offset, _means(fine, hr, SAMPLES // scale, np.zeros(2, int)), sigma, scale
    )


def weave(rng: np.random.Generator, shape: tuple[int, int], finest: float) -> NDArray[np.float64]:
    """Return a texture of unit variance on the canvas: many plane waves, finer ones fainter.

    Up to `finest` cycles per LR pixel, which mostly is more than the frames or the picture show.
    """
    rows, cols = ((n + 2 * MARGIN_PX) * SAMPLES for n in shape)
    row, col = np.mgrid[:rows, :cols] / SAMPLES
    frequency = finest * np.sqrt(rng.uniform(0.01, 1, 60))
    turn, start = rng.uniform(0, 2 * np.pi, (2, 60))
    size, fall = np.zeros((rows, cols)), rng.uniform(0, 1.5)
    for f, a, b in zip(frequency, turn, start, strict=True):
        size += f**-fall * np.cos(2 * np.pi * f * (row * np.sin(a) + col * np.cos(a)) + b)
    return size / size.std()


def mosaic_burst(
    seed: int, shape: tuple[int, int] = (21, 26), *, texture: float = 0.0, **settings: float
) -> MosaicBurst:
    """Return a burst of a random mosaic, a texture of that standard deviation all over it."""
    rng = np.random.default_rng(seed)
    fine = canvas(rng, shape)
    if texture:
        fine = fine + texture * weave(rng, shape, float(rng.uniform(0.4, 0.7)) * 2)
    return observe(fine, shape, rng=rng, **settings)  # type: ignore[arg-type]


def phasor_mosaic(
    seed: int, shape: tuple[int, int] = (21, 26), *, scale: int = 2, snr: float = 50.0
) -> MosaicBurst:
    """Return phasors of surfaces 1 : 60 in brightness; offsets are told to half a fine sample.

    The error of each is even over 1/12 px, 0.024 px rms; noise is that of a component.
    """
    rng = np.random.default_rng(seed)
    light, phase_rad = canvas(rng, shape), rng.uniform(0.2, 2.0) * canvas(rng, shape)
    fine = np.clip(light, 0.1, 0.95) ** 2 * np.exp(1j * phase_rad)
    offset = square(scale) + rng.uniform(-0.5, 0.5, (scale**2, 2)) / SAMPLES
    seen = observe(fine, shape, scale=scale, offset_px=offset, snr=1e9, rng=rng)
    sigma = float(np.median(np.abs(seen.y))) / snr
    noise = rng.standard_normal((2, *seen.y.shape))
    return MosaicBurst(
        seen.y + sigma * (noise[0] + 1j * noise[1]), offset, seen.truth, sigma, scale
    )


def _means(
    fine: NDArray[np.float64],
    shape: tuple[int, int],
    size: int,
    shift: NDArray[np.int_],
    side: int | None = None,
) -> NDArray[np.float64]:
    top, left = MARGIN_PX * SAMPLES + shift
    part = fine[top : top + shape[0] * size, left : left + shape[1] * size]
    cut = 0 if side is None else (size - side) // 2
    seen = slice(cut, size - cut)
    cells = part.reshape(shape[0], size, shape[1], size)[:, seen, :, seen]
    means: NDArray[np.float64] = cells.mean(axis=(1, 3))
    return means
