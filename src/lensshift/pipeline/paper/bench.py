"""The bench of the paper, simulated, and how all experiments reconstruct and measure on it."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Literal

import numpy as np

from lensshift.camera import (
    Illumination,
    LensOptics,
    Readout,
    TofCamera,
    Validity,
    camera_preset,
    named_pattern_px,
    simulate_tof,
)
from lensshift.camera.radiometry import active_electrons_per_s
from lensshift.core.arrays import Floats
from lensshift.core.errors import QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.types import Burst, ShiftField
from lensshift.evaluation.slanted_edge import EdgeResult, measure_edge
from lensshift.optics.lens_file import load_lens
from lensshift.pipeline.calibrate import psf_width_px
from lensshift.pipeline.experiment import images_of
from lensshift.reconstruction.phasor.choice import Channel
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.scene import slanted_edge_card
from lensshift.scene.targets import CARD_DISTANCE_M

_PRESET = camera_preset("o3m151")
GRID = _PRESET.grid
PITCH_MM = GRID.pitch_mm[0]
_FOCAL_MM = 42.7  # of the preset
SHIFT_ERROR_PX = 0.02  # rms, assumed of the stages
# Reflectance / distance^2: the bright side of the edge card, the fabric behind the boxes.
CARD_LIGHT = 0.8 / CARD_DISTANCE_M**2
WALL_LIGHT = 0.04 / 4.0**2
_READ_NOISE = 20.0  # electrons, assumed

Optics = Literal["plain", "petzval_a", "petzval_b"]

SNR = 50.0  # of one frame, as in the paper
# What the reconstruction assumes of a pixel: the fill factor of a square one, None for a Gaussian,
# and the width of the spot, or of the Gaussian. The paper's, and the bench's once it is measured.
Response = tuple[float | None, float]
PUBLISHED: Response = (None, 0.30)
# Of the linear yardstick, fixed: weights chosen by the picture take fine gratings for noise, and
# would make it another solver for an edge than for a grating.
PRIOR_WEIGHT = 0.003
_HALF_COLS = 10  # of the region around an edge, in LR pixels


def paper_camera(
    snr: float,  # amplitude over its standard deviation
    light: float,  # reflectance x cos / distance^2 of the surface that has it
    brightest: float,  # the same of the brightest surface, which stays below a full tap
    *,
    optics: Optics = "plain",  # without aberrations, or traced
    element: int | None = 0,  # what moves: an element from 0, or None for the sensor
    grid: Grid = GRID,  # of the sensor
    output: Literal["o3m", "float"] = "o3m",  # "float" leaves the rounding out
) -> TofCamera:
    """Return the camera of the paper at a given signal to noise ratio.

        snr = c E / sqrt(E / 2 + read noise^2),    E = electrons of both taps

    of the amplitude of one pixel: the exposure is what gives it. Whole centimetres and twelve
    bits, no sunlight, no scattered light: the paper's booth is dark.
    """
    lens = _PRESET.optics  # whose spot is about that of the traced one
    if optics != "plain":
        lens = LensOptics(load_lens(optics), element=element)
    pixels = replace(_PRESET.pixels, fill_factor=1.0)
    camera = replace(
        _PRESET, grid=grid, optics=lens, pixels=pixels, illumination=Illumination((15e6,)),
        scatter=None, validity=Validity(), output=output, name="paper",
    )  # fmt: skip
    contrast = pixels.contrast
    half = snr**2 / (4.0 * contrast**2)
    electrons = half + np.sqrt(half**2 + (snr * _READ_NOISE / contrast) ** 2)
    exposure_s = electrons / (active_electrons_per_s(camera) * light)
    most = electrons * brightest / light
    readout = Readout(
        exposure_s=(float(exposure_s),),
        full_well_electrons=float(1.25 * most),
        read_noise_electrons=_READ_NOISE,
        bits=12,
    )
    return replace(camera, readout=readout)


def px_to_m(count_px: float, distance_m: float) -> float:
    """Return how wide so many pixels are in the scene, seen from the plain lens."""
    return count_px * PITCH_MM / _FOCAL_MM * distance_m


def calibrated_response() -> tuple[Response, float]:
    """Return the width that `calibrate` finds on the edge card of this bench, and its error."""
    burst = simulate_tof(
        slanted_edge_card(), paper_camera(SNR, CARD_LIGHT, CARD_LIGHT, optics="petzval_a"),
        named_pattern_px("4x4"), shift_error_px=SHIFT_ERROR_PX, seed=0,
    ).burst  # fmt: skip
    found = psf_width_px(burst)
    if found is None:
        raise ValueError("expected an edge in the frames of the card, found none")
    return (None, found[0]), found[1]


def reconstructed(
    burst: Burst,
    channel: Channel,
    *,
    scale: int = 2,
    method: str = "auto",
    shift_field: ShiftField | None = None,
    prior_weight: float | None = None,
    response: Response = PUBLISHED,
) -> dict[str, Floats]:
    """Return the images of a burst by channel; doubts about the shifts are part of the study."""
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        result = reconstruct(
            burst, scale, method, channel=channel, std=False, shift_field=shift_field,
            prior_weight=prior_weight, fill_factor=response[0], psf_sigma_px=response[1],
        )  # fmt: skip
    return images_of(result)


def solved(burst: Burst, method: str, response: Response = PUBLISHED, scale: int = 2) -> Floats:
    """Return the amplitude by a method; that of `tikhonov` is linear in the frames."""
    weight = PRIOR_WEIGHT if method == "tikhonov" else None
    return reconstructed(
        burst, "amplitude", scale=scale, method=method, prior_weight=weight, response=response
    )["amplitude"]


def measured_edge(image: Floats, scale: int, frequency_lpmm: Floats | None = None) -> EdgeResult:
    """Measure the edge through the middle of an image, as straight and evenly lit as it is.

    That a reconstruction with a sparse prior is not linear, and aliasing left in one frame, make
    the measurement doubt; both are in what is compared.
    """
    rows, cols = image.shape
    half = _HALF_COLS * scale
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        return measure_edge(
            image,
            PITCH_MM / scale,
            scale=scale,
            region=(0, rows, cols // 2 - half, cols // 2 + half),
            frequency_lpmm=frequency_lpmm,
            most_bends=0,
            tilt=False,
        )
