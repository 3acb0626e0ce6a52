"""What the world does to an image: pixels of a real size, noise, quantisation, shift errors.

It shares no code with `lensshift.forward`, so that an estimate is never checked against its own
assumptions: here the target is a function that is sampled many times per pixel, at the place
where the lens really was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.core.types import Burst
from lensshift.scene import Target

# Four frames that encircle the centred position, as (row, col).
QUARTER_SQUARE_PX = named_pattern_px("square")
QUARTER_SQUARE_PX.setflags(write=False)
_SAMPLES_PER_HR_PX = 10  # along an axis: midpoints, whose error falls with their square
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # its multiples spread evenly over [0, 1)
_SAMPLES_AT_ONCE = 2_000_000  # a few hundred MB at most
_KERNEL_SIGMAS = 4.0  # 6e-5 of a Gaussian lies beyond


@dataclass(frozen=True, slots=True)
class Sensor:
    """The pixels and the errors of a camera.

    Parameters
    ----------
    grid : the LR sampling grid; pixels are square apertures that fill it
    full_well_electrons : electrons of a pixel at full scale; sets the shot noise
    read_noise_electrons : standard deviation of the noise without light
    bits : of the converter, 0 .. full scale

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    grid: Grid
    full_well_electrons: float = 20_000.0
    read_noise_electrons: float = 20.0
    bits: int = 12

    def __post_init__(self) -> None:
        if not self.full_well_electrons > 0 or not self.read_noise_electrons >= 0:
            raise ValueError(
                f"expected a positive full well and read noise >= 0 electrons, got "
                f"{self.full_well_electrons} and {self.read_noise_electrons}"
            )
        if not 1 <= self.bits <= 32:
            raise ValueError(f"expected a converter of 1 to 32 bits, got {self.bits}")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What an experimenter never gets to know.

    Parameters
    ----------
    image : [row col] on the HR grid: what pixels of 1/scale pitch see through the same lens
    offset_px : [frame 2] where the image content really was
    """

    image: Floats
    offset_px: Floats


def simulate_burst(
    target: Target,
    sensor: Sensor,
    planned_px: ArrayLike = QUARTER_SQUARE_PX,
    *,
    scale: int = 2,
    optics_sigma_px: float = 0.1,
    shift_error_px: float = 0.02,
    seed: int = 0,
) -> tuple[Burst, Truth]:
    """Take a burst of a target with a lens that does not go exactly where it was sent.

        y_k(u) = Q[ N[ integral over pixel u of (target * Gaussian)(p - offset_k) dp ] ]
        offset_k = planned_k + e_k,   e_k ~ normal(0, shift_error)

    N is shot and read noise, Q the converter. The burst holds the planned offsets.

    Parameters
    ----------
    planned_px : [frame 2] (row, col); positive: the content moves down / right
    scale : the truth has pixels of 1/scale of the pitch
    optics_sigma_px, shift_error_px : blur of the lens; rms error of the shift along each axis

    Raises
    ------
    ValueError
        If `planned_px` is not [frame 2] or a number is out of range.
    """
    planned = checked_plan(planned_px, scale, sensor.grid)
    if not (optics_sigma_px >= 0 and shift_error_px >= 0):
        raise ValueError("expected optics_sigma_px >= 0 and shift_error_px >= 0")
    rng = np.random.default_rng(seed)
    offset = planned + shift_error_px * rng.standard_normal(planned.shape)
    grid, samples = sensor.grid, _SAMPLES_PER_HR_PX * scale
    frames = [
        _expose(pixel_means(target, grid, at, samples, optics_sigma_px), sensor, rng)
        for at in offset
    ]
    hr_image = pixel_means(
        target, grid.refine(scale), (0.0, 0.0), _SAMPLES_PER_HR_PX, optics_sigma_px * scale
    )
    burst = Burst(
        amplitude=np.stack(frames),
        offset_px=planned,
        grid=grid,
        offset_sigma_px=np.full(planned.shape, float(shift_error_px)),
        meta={"origin": "simulated", "seed": int(seed)},
    )
    return burst, Truth(hr_image, offset)


def checked_plan(planned_px: ArrayLike, scale: int, grid: Grid) -> Floats:
    """Return the planned offsets [frame 2], if they and the scale of the truth can be."""
    planned = np.asarray(planned_px, dtype=np.float64)
    if planned.ndim != 2 or planned.shape[1] != 2 or not len(planned):
        raise ValueError(f"expected planned_px [frame 2], got shape {planned.shape}")
    if not np.all(np.isfinite(planned)):
        raise ValueError("expected finite planned_px, got NaN or infinity")
    beyond = np.any(np.abs(planned) >= grid.shape, axis=1)
    if beyond.any():
        frame = int(beyond.argmax())
        raise ValueError(
            "expected planned_px, in LR pixels, that leave a part of {} x {} px in view, got "
            "({:g}, {:g}) in frame {}".format(*grid.shape, *planned[frame], frame)
        )
    if scale != int(scale) or scale < 1:
        raise ValueError(f"expected an integer scale from 1, got {scale}")
    return planned


def pixel_means(
    target: Target, grid: Grid, offset_px: ArrayLike, samples: int, optics_sigma_px: float
) -> Floats:
    """Integrate a target over the pixels of a grid, without noise.

    Parameters
    ----------
    offset_px : (row, col), how far the content moved down / right, in pixels of `grid`
    samples : per pixel and axis; their mean is the integral
    optics_sigma_px : blur before the pixels, in pixels of `grid`
    """
    moved = np.asarray(offset_px, dtype=np.float64)
    margin = int(np.ceil(_KERNEL_SIGMAS * optics_sigma_px))
    rows, cols = grid.shape
    rows_at_once = max(1, _SAMPLES_AT_ONCE // (samples**2 * (cols + 2 * margin)))
    means = np.empty(grid.shape)
    for first in range(0, rows, rows_at_once):
        last = min(first + rows_at_once, rows)
        places = _sample_places(grid, (first - margin, last + margin), margin, samples, moved)
        means[first:last] = _binned(target(*places), samples, optics_sigma_px, margin)
    return means


def _binned(sharp: Floats, samples: int, optics_sigma_px: float, margin: int) -> Floats:
    """Blur samples, take the mean of each pixel and cut the margin off."""
    from scipy.ndimage import gaussian_filter

    if optics_sigma_px > 0:
        sigma = optics_sigma_px * samples
        sharp = gaussian_filter(sharp, sigma, mode="nearest", truncate=_KERNEL_SIGMAS)
    rows, cols = (count // samples for count in sharp.shape)
    means = sharp.reshape(rows, samples, cols, samples).mean(axis=(1, 3))
    return np.asarray(means[margin : rows - margin, margin : cols - margin])


def _sample_places(
    grid: Grid, rows: tuple[int, int], margin: int, samples: int, moved_px: Floats
) -> tuple[Floats, Floats]:
    """Return where the samples of some rows of pixels lie on the target, in mm from the middle.

    Each line of samples is staggered by another fraction of their spacing: on a plain lattice
    an edge along a row or column would move by a whole sample or not at all.
    """
    row, col = np.meshgrid(
        np.arange(rows[0] * samples, rows[1] * samples),
        np.arange(-margin * samples, (grid.shape[1] + margin) * samples),
        indexing="ij",
    )
    row_px = (row + np.mod(col * GOLDEN, 1.0)) / samples - 0.5 * grid.shape[0] - moved_px[0]
    col_px = (col + np.mod(row * GOLDEN, 1.0)) / samples - 0.5 * grid.shape[1] - moved_px[1]
    return row_px * grid.pitch_mm[0], col_px * grid.pitch_mm[1]


def _expose(image: Floats, sensor: Sensor, rng: np.random.Generator) -> Floats:
    """Return an image with shot noise, read noise and quantisation, full scale 1."""
    electrons = rng.poisson(np.maximum(image, 0.0) * sensor.full_well_electrons)
    read = rng.normal(0.0, sensor.read_noise_electrons, image.shape)
    top = 2**sensor.bits - 1
    codes = np.rint((electrons + read) / sensor.full_well_electrons * top)
    return np.asarray(np.clip(codes, 0, top) / top)
