"""Procedural scenes for time of flight: reflectance and phase of what covers what, to train on.

Walls, boxes, poles, balls, steps of all heights, prints on them; reflectances 1 : 30. The phase is
that of the light that comes back, relative to the middle of the scene.

    python training/depths.py --count 3000 --seed 2 --out depths.npy
"""

from __future__ import annotations

import numpy as np
from worlds import POLE, SIZE, UNIT, Canvas, Generator, log_uniform, paint, shape, write_pool

LEAST_REFLECTANCE = 0.005


def reflectance(rng: Generator, rows: int, cols: int) -> Canvas | float:
    """Return how bright a surface is: mostly one value, sometimes with a texture."""
    mean = log_uniform(rng, 0.03, 1.0)
    texture = paint(rng, rows, cols) if rng.random() < 0.35 else 0.0
    if isinstance(texture, float):
        return mean
    texture = texture - texture.mean()
    texture = texture / max(float(np.abs(texture).max()), 1e-6)
    return np.clip(mean * (1 + rng.uniform(0.1, 0.9) * texture), LEAST_REFLECTANCE, 1.5)


def slope(rng: Generator, rows: int, cols: int) -> Canvas:
    """Return a plane through 0 [row col] whose phase changes by 0.001 to 1 over the scene."""
    row, col = np.mgrid[:rows, :cols].astype(np.float32)
    a, b = log_uniform(rng, 1e-3, 1.0) * 0.5 * rng.standard_normal(2)
    return (a * (row - rows / 2) + b * (col - cols / 2)) / SIZE


def scene(rng: Generator) -> Canvas:
    """Return reflectance and phase [2 row col] of a wall and what stands before it."""
    light = np.broadcast_to(np.asarray(reflectance(rng, SIZE, SIZE), np.float32), (SIZE, SIZE))
    light, phase = light.copy(), slope(rng, SIZE, SIZE)
    span, solid = log_uniform(rng, 0.03, 2.5), rng.random()
    few = rng.random() < 0.6
    for _ in range(int(rng.integers(1, 8)) if few else int(log_uniform(rng, 6, 80))):
        large = few or rng.random() < 0.5
        radius = SIZE * log_uniform(rng, 0.05, 0.45) if large else UNIT * log_uniform(rng, 1, 12)
        step = span * rng.uniform(0.1, 1) if rng.random() < solid else None
        _cover(rng, light, phase, radius, step)
    return np.stack([light, phase - np.median(phase)]).astype(np.float32)


def _cover(rng: Generator, light: Canvas, phase: Canvas, radius: float, step: float | None) -> None:
    """Lay one surface on the scene, in place; without a step it is print on what is there."""
    row, col = rng.uniform(-0.05 * SIZE, 1.05 * SIZE, 2)
    inside, reach = shape(rng, radius, POLE if rng.random() < 0.2 else None)
    top, left = max(int(row - reach), 0), max(int(col - reach), 0)
    bottom, right = min(int(row + reach) + 2, SIZE), min(int(col + reach) + 2, SIZE)
    if bottom - top < 1 or right - left < 1:
        return
    v, u = np.mgrid[top:bottom, left:right].astype(np.float32)
    mask = inside(v - row, u - col)
    part = (slice(top, bottom), slice(left, right))
    value = reflectance(rng, bottom - top, right - left)
    light[part] = np.where(mask, value, light[part])
    if step is None:
        return
    near = -step + slope(rng, bottom - top, right - left)
    if rng.random() < 0.25:  # a ball or a barrel
        near = near + step * rng.uniform(0.2, 0.9) * ((v - row) ** 2 + (u - col) ** 2) / reach**2
    phase[part] = np.where(mask, near, phase[part])


if __name__ == "__main__":
    write_pool(scene, __doc__.split("\n")[0], "depths.npy")
