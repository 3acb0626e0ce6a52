"""A grating beside every edge: what is left of a wave, with the camera and solvers of the edge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from lensshift.camera import TofCamera, TofCapture, named_pattern_px, simulate_tof
from lensshift.core.arrays import Floats
from lensshift.core.types import Burst
from lensshift.pipeline.paper import bench
from lensshift.scene import Plane, Scene
from lensshift.scene.targets import CARD_DISTANCE_M, SLANT_RAD

# The last just below the Nyquist frequency of the result.
GRATINGS_LPMM = (1.0, 2.0, 3.0, 4.0, 5.0, 5.5, 6.0)
# Kind -> method and whether the assumed pixel is the paper's: lens shift, then sensor shift.
SOLVERS: Mapping[str, tuple[str, bool]] = {
    "lens shift": ("auto", False),
    "lens shift, tikhonov": ("tikhonov", False),
    "lens shift, 0.30 px": ("auto", True),
    "lens shift, as published": ("irwsr-toolbox", True),
    "sensor shift": ("auto", False),
    "sensor shift, tikhonov": ("tikhonov", False),
}
_MEAN, _CONTRAST = 0.5, 0.6  # of the reflectance
_BORDER_PX, _HALF_COLS = 2, 13  # of the image that is read, in LR pixels
# A lens magnifies a little other than its focal length says.
_STRETCHES = np.linspace(0.96, 1.04, 161)


@dataclass(frozen=True, slots=True)
class GratingRun:
    """One grating at one phase: kind -> modulation, negative if bright and dark are swapped."""

    frequency_lpmm: float
    modulation: dict[str, float]


def pictures(lens: Burst, sensor: Burst, response: bench.Response) -> dict[str, Floats]:
    """Return what edges and gratings are measured in: a frame, and all reconstructions."""
    alone = lens.select((0,))
    images = {"one frame": np.asarray(lens.amplitude[0]), "bicubic": bench.solved(alone, "bicubic")}
    for kind, (method, published) in SOLVERS.items():
        burst = lens if kind.startswith("lens") else sensor
        images[kind] = bench.solved(burst, method, bench.PUBLISHED if published else response)
    return images


def grating(frequency_lpmm: float, phase_rad: float) -> Scene:
    """Return a wall with a sine wave across the direction of the edge, over the whole sensor."""
    along = _turn(frequency_lpmm / bench.px_to_m(1.0, CARD_DISTANCE_M) * bench.PITCH_MM)

    def reflectance(x_m: Floats, y_m: Floats) -> Floats:
        return _MEAN * (1.0 + _CONTRAST * np.cos(along[1] * x_m + along[0] * y_m + phase_rad))

    return Scene((Plane(centre_m=(0.0, 0.0, CARD_DISTANCE_M), reflectance=reflectance),))


def read_grating(
    image: Floats,  # [row col], over the whole sensor; its rim and far columns are left out
    frequency_lpmm: float,  # of the wave on the sensor
    phase_rad: float,  # of the wave in the middle of the sensor
    *,
    scale: int,  # pixels of the image per LR pixel
    offset_px: tuple[float, float] = (0.0, 0.0),  # of the content, in LR pixels
    stretch: float = 1.0,  # how much finer than that the lens makes it
) -> float:
    """Return the share of a wave that an image shows in the phase in which it was drawn.

    I = c (1 + C (a cos phi - b sin phi)),   modulation = a
    """
    rows, cols = image.shape
    row, col = np.meshgrid(
        (np.arange(rows) - 0.5 * (rows - 1)) / scale - offset_px[0],
        (np.arange(cols) - 0.5 * (cols - 1)) / scale - offset_px[1],
        indexing="ij",
    )
    inside = (np.abs(row) < 0.5 * rows / scale - _BORDER_PX) & (np.abs(col) < _HALF_COLS)
    along = _turn(frequency_lpmm * bench.PITCH_MM * stretch)
    phase = (along[0] * row + along[1] * col)[inside] + phase_rad
    basis = np.stack([np.ones(phase.size), np.cos(phase), -np.sin(phase)], axis=1)
    level, wave, _ = np.linalg.lstsq(basis, image[inside], rcond=None)[0]
    return float(wave / level / _CONTRAST)


def take_grating(
    frequency_lpmm: float, seed: int, response: bench.Response = bench.PUBLISHED
) -> GratingRun:
    """Simulate a grating with both ways of shifting, as the edge card, and read all images."""
    phase_rad = _phase_rad(seed)
    lens, sensor = (
        _capture(frequency_lpmm, seed, "square", bench.paper_camera(
            bench.SNR, bench.CARD_LIGHT, bench.CARD_LIGHT, optics="petzval_a", element=element
        )) for element in (0, None)
    )  # fmt: skip
    truth = partial(read_grating, lens.truth.amplitude, frequency_lpmm, phase_rad, scale=2)
    stretch = max(_STRETCHES.tolist(), key=lambda one: truth(stretch=one))
    row_px, col_px = lens.burst.offset_px[0].tolist()
    images = pictures(lens.burst, sensor.burst, response)
    modulation = {
        kind: read_grating(
            image, frequency_lpmm, phase_rad, stretch=stretch,
            scale=1 if kind == "one frame" else 2,
            offset_px=(row_px, col_px) if kind == "one frame" else (0.0, 0.0),
        )
        for kind, image in images.items()
    }  # fmt: skip
    modulation["half pixel"] = truth(stretch=stretch)
    return GratingRun(frequency_lpmm, modulation)


def grating_of(
    camera: TofCamera, pattern: str, scale: int, frequency_lpmm: float, response: bench.Response,
    *, shift_error_px: float = bench.SHIFT_ERROR_PX, seed: int = 0,
) -> float:  # fmt: skip
    """Return what the default leaves of a grating that a camera with a plain lens saw."""
    capture = _capture(frequency_lpmm, seed, pattern, camera, scale, shift_error_px)
    image = bench.solved(capture.burst, "auto", response, scale)
    return read_grating(image, frequency_lpmm, _phase_rad(seed), scale=scale)


def mean_gratings(runs: list[GratingRun], kind: str) -> Floats:
    """Return the mean modulation of a kind at `frequencies`."""
    return np.array([
        np.mean([one.modulation[kind] for one in runs if one.frequency_lpmm == frequency])
        for frequency in frequencies(runs)
    ])  # fmt: skip


def frequencies(runs: list[GratingRun]) -> Floats:
    """Return the frequencies of the gratings, each once."""
    return np.unique([one.frequency_lpmm for one in runs])


def _capture(
    frequency_lpmm: float, seed: int, pattern: str, camera: TofCamera, scale: int = 2,
    shift_error_px: float = bench.SHIFT_ERROR_PX,
) -> TofCapture:  # fmt: skip
    return simulate_tof(
        grating(frequency_lpmm, _phase_rad(seed)), camera, named_pattern_px(pattern), scale=scale,
        shift_error_px=shift_error_px, seed=seed,
    )  # fmt: skip


def _phase_rad(seed: int) -> float:
    return float(np.random.default_rng([seed, 2]).uniform(0.0, 2.0 * np.pi))


def _turn(cycles: float) -> tuple[float, float]:
    """Return the angular frequency along (row, col) of a wave across the edge of the card."""
    return -2.0 * np.pi * cycles * np.sin(SLANT_RAD), 2.0 * np.pi * cycles * np.cos(SLANT_RAD)
