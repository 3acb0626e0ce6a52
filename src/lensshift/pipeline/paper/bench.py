"""The bench of the paper, simulated: camera, lens and targets."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from lensshift.camera import Illumination, LensOptics, Readout, TofCamera, Validity, camera_preset
from lensshift.camera.radiometry import active_electrons_per_s
from lensshift.core.grid import Grid
from lensshift.optics.lens_file import load_lens
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
