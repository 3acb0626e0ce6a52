"""Procedural scenes to train on: leaves, boxes, poles, gratings, rings, stars, print, textures.

No photograph, no stored test case. A scene is a fine canvas of brightness about 0 to 1; how many of
its samples make an LR pixel is chosen when frames are drawn from it (`bursts.py`).

    python training/worlds.py --count 4000 --seed 1 --out worlds.npy
"""

from __future__ import annotations

import argparse
import string
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter

Canvas = NDArray[np.float32]
Generator = np.random.Generator

SIZE = 416  # samples along a side: 26 LR pixels of 16 samples
UNIT = 5.0  # samples in a typical HR pixel; features are drawn from 0.6 of it upwards
POLE = 4  # among the shapes

_FONTS = [
    path
    for path in font_manager.findSystemFonts(str(Path(font_manager.__file__).parent / "mpl-data"))
    if "Display" not in path and "STIX" not in path and "cmex" not in path and "cmsy" not in path
]


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is evenly distributed."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def scene(rng: Generator, size: int = SIZE) -> Canvas:
    """Return one scene [row col] of finite numbers."""
    while not np.all(np.isfinite(canvas := _drawn(rng, size))):
        pass
    return canvas


def _drawn(rng: Generator, size: int) -> Canvas:
    """Return a layout, often mixed with another along a line, then toned."""
    canvas = _layout(rng, size)
    if rng.random() < 0.2:  # two worlds side by side: what one holds must not cost the other
        row, col = np.mgrid[:size, :size].astype(np.float32)
        angle = rng.uniform(0, 2 * np.pi)
        side = (row - size / 2) * np.sin(angle) + (col - size / 2) * np.cos(angle)
        canvas = np.where(side > rng.uniform(-0.25, 0.25) * size, _layout(rng, size), canvas)
    if rng.random() < 0.25:  # uneven light
        canvas = canvas * (1 + rng.uniform(0.1, 0.6) * _smooth(rng, size))
    if rng.random() < 0.25:  # out of focus as a whole
        canvas = gaussian_filter(canvas, UNIT * log_uniform(rng, 0.2, 1.5))
    return _tone(rng, canvas)


def _layout(rng: Generator, size: int) -> Canvas:
    kind = rng.random()
    if kind < 0.34:
        return _leaves(rng, size, dense=True)
    if kind < 0.66:
        return _leaves(rng, size, dense=False)
    if kind < 0.76:
        return _print(rng, size)
    if kind < 0.84:
        return _chart(rng, size)
    if kind < 0.92:
        return _filled(paint(rng, size, size, textured=True), size)
    if kind < 0.97:
        return _points(rng, size)
    return 0.5 + 0.5 * _smooth(rng, size)


def _filled(value: Canvas | float, size: int) -> Canvas:
    return np.broadcast_to(np.asarray(value, np.float32), (size, size)).copy()


def _tone(rng: Generator, canvas: Canvas) -> Canvas:
    """Spread to 0 .. 1 most of the time, or leave at low contrast; sometimes inverted or curved."""
    low, high = np.quantile(canvas, [0.001, 0.999])
    if high - low > 1e-3:
        canvas = (canvas - low) / (high - low)
    if rng.random() < 0.3:
        canvas = np.clip(canvas, 0, 1) ** log_uniform(rng, 0.5, 2.2)
    if rng.random() < 0.3:
        canvas = 1 - canvas
    span = 1.0 if rng.random() < 0.6 else log_uniform(rng, 0.08, 1.0)
    return (np.clip(canvas, -0.05, 1.05) * span + rng.uniform(0, 1 - span)).astype(np.float32)


def _smooth(rng: Generator, size: int) -> Canvas:
    """Return a smooth field of about -1 .. 1 made of a few long waves."""
    row, col = np.mgrid[:size, :size].astype(np.float32) / size
    field = np.zeros((size, size), np.float32)
    for _ in range(int(rng.integers(1, 5))):
        f = rng.normal(0, 1.2, 2)
        field += rng.uniform(0.2, 1) * np.cos(
            2 * np.pi * (f[0] * row + f[1] * col) + rng.uniform(0, 6.3)
        )
    return field / max(float(np.abs(field).max()), 1e-6)


def paint(rng: Generator, rows: int, cols: int, textured: bool = False) -> Canvas | float:
    """Return what covers a surface: a tone, a ramp, a grating, rings, texture."""
    tone = rng.uniform(0, 1)
    kind = rng.uniform(0.5, 1) if textured else rng.random()
    if kind < 0.5:
        return float(tone)
    row, col = np.mgrid[:rows, :cols].astype(np.float32)
    angle = rng.uniform(0, np.pi) if rng.random() < 0.7 else rng.choice([0, np.pi / 2])
    along = row * np.sin(angle) + col * np.cos(angle)
    if kind < 0.6:
        return tone + rng.uniform(-0.5, 0.5) * (along - along.mean()) / max(rows, cols)
    depth = rng.uniform(0.02, 0.5)
    if kind < 0.72:  # a grating of 0.01 to 0.55 cycles per HR pixel
        wave = np.sin(2 * np.pi * log_uniform(rng, 0.01, 0.55) / UNIT * along + rng.uniform(0, 6.3))
        return tone + depth * (np.sign(wave) if rng.random() < 0.4 else wave)
    if kind < 0.8:  # rings or a chirp that ends at that frequency
        centre = rng.uniform(-0.2, 1.2, 2) * (rows, cols)
        squared = (
            (row - centre[0]) ** 2 + (col - centre[1]) ** 2 if rng.random() < 0.7 else along**2
        )
        rate = np.pi * log_uniform(rng, 0.03, 0.6) / UNIT / max(float(squared.max()) ** 0.5, 1.0)
        wave = np.cos(rate * squared + rng.uniform(0, 6.3))
        return tone + depth * (np.sign(wave) if rng.random() < 0.2 else wave)
    return tone + rng.uniform(0.02, 0.3) * _texture(rng, rows, cols, angle)


def _texture(rng: Generator, rows: int, cols: int, angle: float) -> Canvas:
    """Return noise of unit variance with a power-law spectrum, even or stretched along a line."""
    fr, fc = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None]
    stretch = log_uniform(rng, 1, 8) if rng.random() < 0.4 else 1.0
    u, v = fr * np.cos(angle) - fc * np.sin(angle), fr * np.sin(angle) + fc * np.cos(angle)
    radius = np.hypot(u, v * stretch)
    if rng.random() < 0.3:  # weave or grass: a band of frequencies
        centre, width = log_uniform(rng, 0.03, 0.4) / UNIT, rng.uniform(0.2, 0.8)
        gain = np.exp(-0.5 * (np.log(np.maximum(radius, 1e-6) / centre) / width) ** 2) / centre
    else:
        gain = np.maximum(radius, 0.5 / max(rows, cols)) ** -rng.uniform(0.7, 1.8)
    gain = gain * np.exp(-0.5 * (radius * UNIT * rng.uniform(0.2, 1.0)) ** 2 * 6)
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((rows, cols))) * gain, s=(rows, cols))
    if rng.random() < 0.2 and noise.std() > 1e-6:
        noise = np.exp(noise / noise.std())
    return ((noise - noise.mean()) / max(float(noise.std()), 1e-9)).astype(np.float32)


def _leaves(rng: Generator, size: int, dense: bool) -> Canvas:
    """Return shapes that cover each other: a few large ones, or many by a power law of sizes."""
    canvas = _filled(paint(rng, size, size), size)
    count = int(log_uniform(rng, 20, 400)) if dense else int(rng.integers(1, 9))
    plain = rng.choice([0.0, 0.5, 0.85, 1.0]) if dense else rng.choice([0.5, 0.9, 1.0])
    smallest, exponent = UNIT * log_uniform(rng, 0.6, 4), rng.uniform(1.2, 2.2)
    soft = UNIT * log_uniform(rng, 0.2, 2) if rng.random() < 0.25 else 0.0
    for _ in range(count):
        radius = (
            min(smallest * rng.random() ** (-1 / exponent), 0.5 * size)
            if dense
            else size * log_uniform(rng, 0.03, 0.45)
        )
        _cover(rng, canvas, radius, plain, soft if rng.random() < 0.5 else 0.0)
    return canvas


def _cover(rng: Generator, canvas: Canvas, radius: float, plain: float, soft: float) -> None:
    """Lay one shape of about that radius on the canvas, in place."""
    size = len(canvas)
    row, col = rng.uniform(-0.05 * size, 1.05 * size, 2)
    inside, reach = shape(rng, radius)
    top, left = max(int(row - reach), 0), max(int(col - reach), 0)
    bottom, right = min(int(row + reach) + 2, size), min(int(col + reach) + 2, size)
    if bottom - top < 1 or right - left < 1:
        return
    v, u = np.mgrid[top:bottom, left:right].astype(np.float32)
    mask = inside(v - row, u - col).astype(np.float32)
    if soft:
        mask = gaussian_filter(mask, soft)
    value = rng.uniform(0, 1) if rng.random() < plain else paint(rng, bottom - top, right - left)
    part = canvas[top:bottom, left:right]
    part += mask * (value - part)


def shape(rng: Generator, radius: float, kind: int | None = None):
    """Return a function of (row, col) from the centre that is true inside, and its reach."""
    kind = rng.integers(0, 7) if kind is None else kind
    angle = rng.uniform(0, np.pi)
    if rng.random() < 0.25:
        angle = rng.choice([0, np.pi / 2]) + rng.normal(0, 0.05)
    c, s = np.cos(angle), np.sin(angle)
    if kind == 0:
        return lambda v, u: u * u + v * v < radius**2, radius
    if kind in (1, 2):
        half = radius * rng.uniform(0.3, 1)
        return (
            lambda v, u: (abs(u * c + v * s) < radius) & (abs(v * c - u * s) < half),
            1.5 * radius,
        )
    if kind == 3:
        squeeze = rng.uniform(0.2, 1)
        return (
            lambda v, u: (u * c + v * s) ** 2 + ((v * c - u * s) / squeeze) ** 2 < radius**2,
            radius,
        )
    if kind == POLE:  # a pole or a line
        half, length = UNIT * log_uniform(rng, 0.25, 3), radius * rng.uniform(1, 4)
        return (
            lambda v, u: (abs(u * c + v * s) < length) & (abs(v * c - u * s) < half),
            length + half,
        )
    corners = rng.uniform(0, 2 * np.pi) + np.arange(n := int(rng.integers(3, 7))) * 2 * np.pi / n
    reach = radius * rng.uniform(0.4, 1, n)
    if kind == 5:
        return lambda v, u: np.all(
            [u * np.cos(a) + v * np.sin(a) < r for a, r in zip(corners, reach, strict=True)], axis=0
        ), 2.5 * radius
    spikes = int(rng.integers(3, 9))
    return (
        lambda v, u: (
            np.hypot(u, v) < radius * (0.6 + 0.4 * np.cos(spikes * np.arctan2(v, u) + angle))
        ),
        radius,
    )


def _print(rng: Generator, size: int) -> Canvas:
    """Return lines of random letters, or of signs that nobody reads, at any size and angle."""
    ground, ink = rng.uniform(0.5, 1), rng.uniform(0, 0.4)
    if rng.random() < 0.4:
        return ground + (ink - ground) * _signs(rng, size)
    image = Image.new("F", (2 * size, 2 * size), 0.0)
    draw = ImageDraw.Draw(image)
    row = 0.0
    while row < 2 * size:
        points = int(UNIT * log_uniform(rng, 3, 25))
        font = ImageFont.truetype(str(rng.choice(_FONTS)), max(points, 6))
        letters = string.ascii_letters + string.digits + ".,:;-+()   "
        text = "".join(rng.choice(list(letters), int(2.6 * 2 * size / points)))
        draw.text((rng.uniform(-20, 0), row), text, fill=1.0, font=font)
        row += points * rng.uniform(1.0, 1.8)
    lean = rng.normal(0, 3) if rng.random() < 0.7 else rng.uniform(0, 90)
    angle = float(rng.choice([0, 90, 180, 270]) + lean)
    image = image.rotate(angle, resample=Image.Resampling.BILINEAR)
    half = size // 2
    page = np.asarray(image, np.float32)[half : half + size, half : half + size]
    canvas = ground + (ink - ground) * page
    if rng.random() < 0.4:
        canvas = canvas + rng.uniform(0.01, 0.1) * _texture(rng, size, size, 0.0)
    return canvas


def _signs(rng: Generator, size: int) -> Canvas:
    """Return random dots in cells of 0.3 to 2.5 HR pixels, in words or all over; 0 to 1.

    Most of this is too small to be read: the error bar has to say so.
    """
    side = UNIT * log_uniform(rng, 0.3, 2.5)
    count = int(1.5 * size / side) + 2
    dots = rng.random((count, count)) < rng.uniform(0.2, 0.8)
    if rng.random() < 0.7:  # letters of 5 x 7 dots, a dot or two apart
        height, width = 7 + int(rng.integers(1, 4)), 5 + int(rng.integers(1, 3))
        row, col = np.mgrid[:count, :count]
        dots &= (row % height < 7) & (col % width < 5)
    angle = rng.normal(0, 0.05) if rng.random() < 0.7 else rng.uniform(0, np.pi)
    v, u = np.mgrid[:size, :size].astype(np.float32) - size / 2
    c, s = np.cos(angle), np.sin(angle)
    row, col = (
        np.floor(part / side + count / 2).astype(int) for part in (v * c - u * s, v * s + u * c)
    )
    return dots[np.clip(row, 0, count - 1), np.clip(col, 0, count - 1)].astype(np.float32)


def _chart(rng: Generator, size: int) -> Canvas:
    """Return a chart: star, bars of rising frequency, checkerboard or one large zone plate."""
    row, col = np.mgrid[:size, :size].astype(np.float32)
    centre = size * rng.uniform(0.2, 0.8, 2)
    v, u = row - centre[0], col - centre[1]
    kind = rng.integers(0, 4)
    if kind == 0:
        wave = np.sin(rng.integers(4, 60) * np.arctan2(v, u) + rng.uniform(0, 6.3))
    elif kind == 1:
        angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)])
        strip = np.floor((v * np.cos(angle) - u * np.sin(angle)) / (size * rng.uniform(0.08, 0.3)))
        frequency = 0.05 + 0.5 * ((strip * 0.37) % 1.0)
        wave = np.sin(2 * np.pi * frequency / UNIT * (v * np.sin(angle) + u * np.cos(angle)))
    elif kind == 2:
        period = UNIT * log_uniform(rng, 2, 20)
        angle = rng.normal(0, 0.3)
        c, s = np.cos(angle), np.sin(angle)
        wave = np.sin(np.pi * (u * c + v * s) / period) * np.sin(np.pi * (v * c - u * s) / period)
    else:
        wave = np.cos(np.pi * rng.uniform(0.1, 0.6) / UNIT / (size / 2) * (u * u + v * v))
    if rng.random() < 0.55 and kind < 3:
        wave = np.sign(wave)
    return (0.5 + 0.5 * wave * rng.uniform(0.2, 1)).astype(np.float32)


def _points(rng: Generator, size: int) -> Canvas:
    """Return small lights on a dim smooth ground."""
    canvas = rng.uniform(0, 0.3) * (1 + _smooth(rng, size))
    v, u = np.mgrid[:size, :size].astype(np.float32)
    for _ in range(int(log_uniform(rng, 5, 150))):
        row, col = rng.uniform(0, size, 2)
        sigma = UNIT * log_uniform(rng, 0.15, 1.5)
        top, left = max(int(row - 4 * sigma), 0), max(int(col - 4 * sigma), 0)
        part = (slice(top, int(row + 4 * sigma) + 2), slice(left, int(col + 4 * sigma) + 2))
        spot = np.exp(-((v[part] - row) ** 2 + (u[part] - col) ** 2) / (2 * sigma**2))
        canvas[part] += rng.uniform(0.1, 1) * spot
    return canvas.astype(np.float32)


def write_pool(draw: Callable[[Generator], Canvas], what: str, out: str) -> None:
    """Write a pool of scenes in half precision, as the command line asks; each has its own seed."""
    ask = argparse.ArgumentParser(description=what)
    ask.add_argument("--count", type=int, default=4000)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--workers", type=int, default=1)
    ask.add_argument("--out", type=Path, default=Path(out))
    given = ask.parse_args()
    rngs = (np.random.default_rng((given.seed, number)) for number in range(given.count))
    began, pool = time.monotonic(), None
    with ProcessPoolExecutor(given.workers) as workers:
        for number, one in enumerate(workers.map(draw, rngs, chunksize=20)):
            if pool is None:
                shape = (given.count, *one.shape)
                pool = np.lib.format.open_memmap(given.out, "w+", np.float16, shape)
            pool[number] = one
            if number % 100 == 99:
                sys.stdout.write(f"{number + 1} scenes, {time.monotonic() - began:.0f} s\n")
                sys.stdout.flush()


if __name__ == "__main__":
    write_pool(scene, __doc__.split("\n")[0], "worlds.npy")
