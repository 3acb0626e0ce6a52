"""Draw bursts from scenes, with everything that goes wrong in a camera, for training.

The world side (apertures integrated over fine samples) is written here and shares nothing with the
assumed model, whose taps come from `lensshift.forward`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter

from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import Taps, forward_model
from lensshift.reconstruction.learned.method import USUAL_SHIFT_ERROR_PX
from lensshift.reconstruction.learned.noise import LEAST_FRAMES, LEAST_SHARE, LEAST_SIGMA
from lensshift.reconstruction.learned.solver import SQUARE_REACH_PX
from lensshift.reconstruction.noise import light_of
from lensshift.reconstruction.noise_law import noise_law
from lensshift.reconstruction.problem import SQUARE_PIXEL_PX

Array = NDArray[np.float64]
Tensor = torch.Tensor
Generator = np.random.Generator

# Cameras that move a lens take four frames, mostly: so many besides those of `draw_geometry`.
USUAL, USUAL_OF_PHASORS = 0.3, 0.5
# Share of bursts without errors of the shifts: measured ones of phasors always have some.
EXACT, EXACT_OF_PHASORS = 0.6, 0.25
# Share of bursts whose noise is read from the frames, as it mostly is, errors and all.
READ = 0.55
# Share of scenes with grain all over or in parts: photographs have no even surfaces.
GRAINY = 0.4
MARGIN = 2  # LR pixels of scene around the frame, seen only by shifted apertures


@dataclass(frozen=True)
class Geometry:
    """What all bursts of one batch share."""

    scale: int
    shape: tuple[int, int]
    offset_px: Array
    samples: int

    @property
    def fine_shape(self) -> list[int]:
        """Samples [row col] of a scene under the frame and its margin."""
        return [(n + 2 * MARGIN) * self.samples for n in self.shape]


@dataclass(frozen=True)
class Batch:
    """Frames of a batch, what the solver is told of them, and the truth."""

    frames: Tensor  # [burst frame row col], phasors [burst component frame row col]
    valid: Tensor  # [burst frame row col], 0 or 1
    sigma: Tensor  # same shape, what the solver believes
    noise: Tensor  # same shape, what it is
    truth: Tensor  # [burst row col] on the HR grid, phasors [burst component row col]
    rows: Tensor  # [frame row HR row]
    cols: Tensor  # [frame col HR col]
    blur_hr_px: float
    scale: int


def dense_taps(taps: Taps, size: int) -> Array:
    """Return the taps of one axis as matrices [frame pixel size]."""
    dense = np.zeros((*taps.start.shape, size))
    index = taps.start[..., None] + np.arange(taps.weight.shape[-1])
    np.put_along_axis(dense, index, taps.weight, axis=-1)
    return dense


def draw_geometry(rng: Generator, hr_side: int = 56) -> Geometry:
    """Return scale, shape and shifts of a burst, half of them on the usual square patterns."""
    scale = int(rng.choice([1, 2, 3, 4, 5, 6, 8], p=[0.02, 0.6, 0.16, 0.16, 0.02, 0.02, 0.02]))
    side = min(hr_side // scale, 28)
    shape = (side, side) if rng.random() < 0.7 else (side, max(side - int(rng.integers(1, 4)), 4))
    few = {1: [1, 2, 4], 2: [1, 2, 3, 4, 4, 4, 4, 4, 5, 9, 16], 3: [2, 4, 5, 9, 9, 12, 16]}
    count = int(rng.choice(few.get(scale, [3, 4, 9, 16, 16])))
    side = round(count**0.5)
    kind = rng.random()
    if side * side == count and kind < 0.6:
        offset = square_px(rng, side, 1.0 / scale, 0.3)
    else:
        offset = rng.uniform(-1, 1, (count, 2)) * (0.5 if kind < 0.9 else 1.5)
    samples = int(rng.choice([10, 12, 13] if scale < 3 else [12, 15, 16]))
    return Geometry(scale, shape, np.clip(offset, -1.6, 1.6), samples)


def square_px(rng: Generator, side: int, other_px: float, aside: float) -> Array:
    """Return a square pattern, rarely of another step, a part of them aside, or by whole pixels."""
    step = 1.0 / side if rng.random() < 0.85 else other_px
    line = (np.arange(side) - (side - 1) / 2) * step
    offset = np.array([(a, b) for a in line for b in line])
    if rng.random() < aside:
        offset = offset + rng.uniform(-0.5, 0.5, 2)
    if rng.random() < 0.3:
        offset = offset + rng.integers(-1, 2, offset.shape)
    return offset


def usual_geometry(rng: Generator, side: int = 28, wander_px: float = 0.0) -> Geometry:
    """Return four frames, half an HR pixel around the middle, at twice the resolution.

    With `wander_px` every other burst has its frames elsewhere by as much, and as told.
    """
    shape = (side, side) if rng.random() < 0.5 else (side // 2, side)
    offset = np.array([(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)])
    if wander_px and rng.random() < 0.5:
        offset = offset + wander_px * rng.uniform(-1, 1, offset.shape)
    return Geometry(2, shape, offset, int(rng.choice([10, 12])))


def _overlap(centre: Array, width: float, samples: int, size: int) -> Array:
    """Return the mean over [centre - width/2, centre + width/2] LR pixels of fine samples."""
    low = (centre - width / 2 + MARGIN + 0.5) * samples
    high = (centre + width / 2 + MARGIN + 0.5) * samples
    edge = np.arange(size + 1)
    part = np.minimum(high[..., None], edge[1:]) - np.maximum(low[..., None], edge[:-1])
    part = np.clip(part, 0, None)
    return part / part.sum(-1, keepdims=True)


def _spread(matrix: Array, sigma_samples: float) -> Array:
    """Return an aperture blurred by the optics in front of it."""
    if sigma_samples < 0.2:
        return matrix
    return gaussian_filter1d(matrix, sigma_samples, axis=-1, mode="nearest")


@dataclass(frozen=True)
class Bench:
    """A camera before scenes: what it does to them, and what is told of it."""

    geometry: Geometry
    told_px: float
    rows: Tensor
    cols: Tensor
    fine: tuple[Tensor, Tensor]  # [HR row sample], what an HR pixel is the mean of
    fill: float
    optics_px: float
    nominal: bool  # the world blurs as the model says: a Gaussian of HR pixels

    def truth(self, scenes: Tensor) -> Tensor:
        """Return the pictures [... row col] that are wanted of scenes."""
        return self.fine[0] @ scenes @ self.fine[1].T

    def frames(self, scenes: Tensor, wrong: Array) -> Tensor:
        """Return [burst frame row col] with the shifts of each burst off by `wrong`."""
        g = self.geometry
        if self.nominal and not wrong.any():
            truth = self.truth(scenes)
            return torch.einsum("kuh,bhw,kvw->bkuv", self.rows, truth, self.cols)
        offset = np.clip(g.offset_px + wrong, -1.9, 1.9)
        seen = []
        for axis, n in enumerate(g.shape):
            at = np.arange(n)[None, None] - offset[..., axis, None]
            aperture = _overlap(at, self.fill, g.samples, scenes.shape[1 + axis])
            seen.append(_float(_spread(aperture, self.optics_px * g.samples)))
        return torch.einsum("bkuh,bhw,bkvw->bkuv", seen[0], scenes, seen[1])


def draw_bench(rng: Generator, usual: float = USUAL, wander_px: float = 0.0) -> Bench:
    """Return a camera; what is told of its blur is the pixel's, pixel's and lens's, or wrong.

    Wanted is what smaller pixels behind the same lens see; no pixel is wider than a square one.
    """
    square = rng.random() < usual
    g = usual_geometry(rng, wander_px=wander_px) if square else draw_geometry(rng)
    fill = 1.0 if rng.random() < 0.55 else float(rng.uniform(0.4, 1))
    optics = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.03, 0.35))
    lens = optics if rng.random() < 0.4 else 0.0
    nominal = rng.random() < 0.4
    told = np.sqrt(fill**2 / 12 + lens**2)
    if rng.random() < 0.2:
        told *= np.exp(rng.normal(0, 0.25))
    told = min(told, SQUARE_PIXEL_PX)
    model = forward_model(g.shape, g.scale, g.offset_px, blur=GaussianBlur(float(told)))
    hr = model.hr_shape
    seen = 0.0 if nominal else optics * g.samples
    fine = tuple(
        _float(_spread(_overlap((np.arange(n) + 0.5) / g.scale - 0.5, 1 / g.scale, g.samples, m),
                       seen))
        for n, m in zip(hr, g.fine_shape, strict=True)
    )  # fmt: skip
    taps = (_float(dense_taps(t, n)) for t, n in zip((model.rows, model.cols), hr, strict=True))
    return Bench(g, float(told), *taps, fine, fill, optics, nominal)


def draw_errors(rng: Generator, g: Geometry, count: int, exact: float = EXACT) -> Array:
    """Return what the shifts of bursts are off by, [burst frame 2] in pixels."""
    # Most rigs are calibrated, most users tell the truth; what is rarer is seen often enough.
    errors = [0.01, 0.02, 0.05, rng.uniform(0, 0.12)]
    error = 0.0 if rng.random() < exact else float(rng.choice(errors))
    wrong = error * rng.standard_normal((count, *g.offset_px.shape))
    odd = rng.random(count) < (0.2 if rng.random() < 0.25 else 0.0)  # a frame of elsewhere
    which = rng.integers(0, len(g.offset_px), count)
    for k in np.flatnonzero(odd):
        wrong[k, which[k]] += rng.uniform(-1, 1, 2) * 1.4
    return wrong


def draw_batch(
    rng: Generator, pool: NDArray[np.float16], count: int, square: bool = False
) -> Batch:
    """Return bursts of one geometry from scenes of the pool, all on the usual square if asked."""
    bench = draw_bench(rng, 1.0, SQUARE_REACH_PX) if square else draw_bench(rng)
    g = bench.geometry
    scenes = drawn_scenes(rng, pool, g, count)
    frames = bench.frames(scenes, draw_errors(rng, g, count))
    frames, valid, sigma, noise = spoilt(rng, frames.numpy())
    if len(g.offset_px) >= LEAST_FRAMES:
        for k in np.flatnonzero(rng.random(count) < READ):
            sigma[k] = read_noise(g.offset_px, frames[k], valid[k], bench.told_px)
    seen_by_solver = (_float(frames), _float(valid), _float(sigma), _float(noise))
    return Batch(*seen_by_solver, bench.truth(scenes), bench.rows, bench.cols,
                 bench.told_px * g.scale, g.scale)  # fmt: skip


def drawn_scenes(rng: Generator, pool: NDArray[np.float16], g: Geometry, count: int) -> Tensor:
    """Return scenes [burst row col] of the pool, some of them with grain."""
    drawn = [_crop(rng, pool, g.fine_shape) for _ in range(count)]
    grainy = [_with_grain(rng, s, g) if rng.random() < GRAINY else s for s in drawn]
    return _float(np.stack(grainy))


def read_noise(offset_px: Array, y: Array, valid: Array, told_px: float) -> Array:
    """Return the noise of frames as the package reads it, where texture may be taken for it."""
    used = valid > 0
    law = noise_law(offset_px, y, valid, told_px)
    least = max(LEAST_SHARE * float(np.std(y[used])), LEAST_SIGMA)
    return np.sqrt(np.maximum(law.variance(light_of(y, used)), least**2))


def draw_phasors(
    rng: Generator, pool: NDArray[np.float16], count: int, square: bool = False
) -> Batch:
    """Return bursts of phasors [burst component ...] of one geometry, turned by random phases."""
    bench = draw_bench(rng, *((1.0, SQUARE_REACH_PX) if square else (USUAL_OF_PHASORS,)))
    g = bench.geometry
    scenes = np.stack([_crop(rng, pool, g.fine_shape) for _ in range(count)])
    light, phase = scenes[:, 0], scenes[:, 1] + rng.uniform(0, 2 * np.pi, (count, 1, 1))
    parts = [light * np.cos(phase), light * np.sin(phase), light]
    wrong = draw_errors(rng, g, count, EXACT_OF_PHASORS)
    seen = np.stack([bench.frames(_float(part), wrong).numpy() for part in parts], 1)
    truth = torch.stack([bench.truth(_float(part)) for part in parts[:2]], 1)
    frames, valid, sigma, noise = _spoil_phasors(rng, seen[:, :2], seen[:, 2])
    seen_by_solver = (_float(frames), _float(valid), _float(sigma), _float(noise))
    return Batch(*seen_by_solver, truth, bench.rows, bench.cols, bench.told_px * g.scale, g.scale)


def _float(values: NDArray[np.floating]) -> Tensor:
    return torch.tensor(np.ascontiguousarray(values, np.float32))


def _crop(rng: Generator, pool: NDArray[np.float16], size: list[int]) -> NDArray[np.float32]:
    """Return a part of a scene [... row col], mirrored and turned at random."""
    scene = pool[rng.integers(len(pool))]
    if rng.random() < 0.5:
        scene = np.swapaxes(scene, -1, -2)
    top, left = (
        int(rng.integers(0, n - m + 1)) for n, m in zip(scene.shape[-2:], size, strict=True)
    )
    part = scene[..., top : top + size[0], left : left + size[1]].astype(np.float32)
    if rng.random() < 0.5:
        part = part[..., ::-1, :]
    if rng.random() < 0.5:
        part = part[..., ::-1]
    return np.ascontiguousarray(part)


def _with_grain(rng: Generator, scene: NDArray[np.float32], g: Geometry) -> NDArray[np.float32]:
    """Add texture with a power law up to 0.3 to 1.5 cycles per HR pixel, mostly too fine to see.

    It covers all, or what is brighter or darker than somewhere; half of it follows the light.
    """
    hr_samples = g.samples / g.scale
    row, col = np.fft.fftfreq(scene.shape[0])[:, None], np.fft.rfftfreq(scene.shape[1])[None]
    radius = np.hypot(row, col) * hr_samples  # cycles per HR pixel
    gain = np.maximum(radius, 0.02) ** -rng.uniform(0.0, 1.6) * (radius < rng.uniform(0.3, 1.5))
    gain[0, 0] = 0.0
    white = rng.standard_normal(scene.shape)
    grain = np.fft.irfft2(np.fft.rfft2(white) * gain, s=scene.shape)
    grain *= np.exp(rng.uniform(np.log(0.003), np.log(0.1))) / max(float(grain.std()), 1e-9)
    if rng.random() < 0.5:
        grain = grain * 1.5 * scene
    if rng.random() < 0.4:
        level = scene[tuple(rng.integers(0, scene.shape))]
        grain = grain * (scene > level if rng.random() < 0.5 else scene <= level)
    return (scene + grain).astype(np.float32)


def spoilt(rng: Generator, y: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
    """Return frames with noise and faults, valid mask, sigma as believed and as it is."""
    bursts, count = y.shape[:2]
    one = (bursts, 1, 1, 1)
    sigma = 0.8 / np.exp(rng.uniform(np.log(3.0), np.log(4000.0), one))
    share = np.where(rng.random(one) < 0.3, rng.uniform(0.3, 1, one), 0.0)
    light = np.clip(y, 0.02, None) / 0.8
    true = sigma * np.sqrt(1 - share + share * light)
    noisy = y + true * rng.standard_normal(y.shape)
    if rng.random() < 0.12:
        noisy = noisy * (1 + 0.02 * rng.standard_normal((bursts, count, 1, 1)))
        noisy = noisy + 0.01 * rng.standard_normal((bursts, count, 1, 1))
    if rng.random() < 0.12:
        bits = int(rng.integers(6, 11))
        noisy = np.round(noisy * 2**bits) / 2**bits
    if rng.random() < 0.12:  # salt and pepper
        draw, part = rng.random(y.shape), float(rng.choice([0.003, 0.01, 0.02, 0.05]))
        noisy = np.where(draw < part / 2, 0.0, np.where(draw > 1 - part / 2, 1.0, noisy))
    if rng.random() < 0.08:
        noisy = _move(rng, noisy)
    valid = np.ones(y.shape, np.float32)
    if rng.random() < 0.1:
        valid *= rng.random((bursts, 1, *y.shape[2:])) > 0.03
    if rng.random() < 0.05:
        valid *= rng.random(y.shape) > 0.05
    known = rng.random(one) < 0.6
    mean = np.sqrt(np.mean(true**2, axis=(1, 2, 3), keepdims=True))
    smooth = sigma * np.sqrt(1 - share + share * np.clip(noisy, 0.02, None) / 0.8)
    told = np.where(known, smooth, mean) * np.exp(0.08 * rng.standard_normal(one))
    told, true = (np.broadcast_to(part, y.shape) for part in (told, true))
    return noisy * valid, valid, told.copy(), true


def _move(rng: Generator, y: NDArray[np.floating]) -> NDArray[np.floating]:
    """Shift a part of one frame [burst ... frame row col] by a pixel or two: something moved."""
    y = y.copy()
    rows, cols = y.shape[-2:]
    for burst in y:
        frame = burst[..., rng.integers(burst.shape[-3]), :, :]
        top, left = rng.integers(0, max(rows - 3, 1)), rng.integers(0, max(cols - 3, 1))
        part = (..., slice(top, top + rows // 2), slice(left, left + cols // 2))
        frame[part] = np.roll(frame, rng.integers(-2, 3, 2), (-2, -1))[part]
    return y


def _spoil_phasors(
    rng: Generator, z: NDArray[np.float32], light: NDArray[np.float32]
) -> tuple[NDArray[np.float32], ...]:
    """Return phasors with noise and faults, valid mask, sigma of a component as told and as is.

    Shot noise follows all light of a pixel, also where two surfaces cancel in its phasor.
    """
    bursts, count = light.shape[:2]
    one = (bursts, 1, 1, 1)
    usual = np.maximum(np.median(light, axis=(1, 2, 3)), 1e-3).reshape(one)
    sigma = usual / np.exp(rng.uniform(np.log(3.0), np.log(500.0), one))
    share = rng.uniform(0, 1, one)
    true = sigma * np.sqrt(1 - share + share * light / usual)
    noisy = z + true[:, None] * rng.standard_normal(z.shape)
    if rng.random() < 0.12:
        noisy = noisy * (1 + 0.02 * rng.standard_normal((bursts, 1, count, 1, 1)))
    if rng.random() < 0.15:
        noisy = _move(rng, noisy)
    valid = np.ones(light.shape, np.float32)
    if rng.random() < 0.12:
        valid *= rng.random((bursts, 1, *light.shape[2:])) > 0.03
    if rng.random() < 0.08:  # pixels that say anything
        wild = rng.random(light.shape) < 0.01
        noisy = noisy + 3 * usual[:, None] * wild[:, None] * rng.standard_normal(z.shape)
    amplitude = np.hypot(noisy[:, 0], noisy[:, 1])
    around = uniform_filter(amplitude, (0, 0, 3, 3), mode="nearest")
    law = sigma * np.sqrt(1 - share + share * around / usual)
    even = np.sqrt(np.mean(true**2, axis=(1, 2, 3), keepdims=True))
    told = np.where(rng.random(one) < 0.75, law, even) * np.exp(0.08 * rng.standard_normal(one))
    steep = sum(np.sum(slope**2, axis=1) for slope in np.gradient(noisy, axis=(-2, -1))) / 2
    told = np.sqrt(told**2 + USUAL_SHIFT_ERROR_PX**2 * steep)
    return noisy * valid[:, None], valid, np.broadcast_to(told, light.shape), true
