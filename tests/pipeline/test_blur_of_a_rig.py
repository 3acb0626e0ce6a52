"""The blur of a rig from the straight edges of a scene, against its closed form."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from lensshift.camera import PlainOptics, camera_preset, simulate_tof_burst
from lensshift.core.types import Burst
from lensshift.pipeline.calibrate import psf_width_px
from lensshift.pipeline.experiment_file import named_optics, named_scene

SHAPE = (15, 29)
TURN_RAD = 0.2
SPOT_PX = 0.2
FINER = 7


def scan(picture, noise: float = 0.003) -> Burst:  # type: ignore[no-untyped-def]
    """Return frames of a picture(row, col), seen by square pixels, some fractions apart."""
    rng = np.random.default_rng(4)
    offset_px = np.stack(np.meshgrid([-0.5, -0.2, 0.1, 0.4], [-0.6, -0.1, 0.35]), -1).reshape(-1, 2)
    sub = (np.arange(FINER) + 0.5) / FINER - 0.5
    row, col = ((np.arange(n)[:, None] + sub).ravel() - (n - 1) / 2 for n in SHAPE)
    frames = []
    for down, right in offset_px:
        fine = picture(row[:, None] - down, col - right)
        cells = fine.reshape(SHAPE[0], FINER, SHAPE[1], FINER)
        frames.append(cells.mean(axis=(1, 3)) + noise * rng.standard_normal(SHAPE))
    return Burst.from_arrays(np.array(frames), pitch_mm=0.155, offset_px=offset_px)


def card(row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a turned bright card with Gaussian edges."""
    right = col * np.cos(TURN_RAD) + row * np.sin(TURN_RAD)
    down = row * np.cos(TURN_RAD) - col * np.sin(TURN_RAD)
    sides = [(8.0 - np.abs(right)), (4.5 - np.abs(down))]
    return 0.2 + 0.6 * ndtr(sides[0] / SPOT_PX) * ndtr(sides[1] / SPOT_PX)


def test_width_of_optics_and_pixel() -> None:
    def modulation(f: float) -> float:
        pixel = np.sinc(f * np.cos(TURN_RAD)) * np.sinc(f * np.sin(TURN_RAD))
        return float(pixel * np.exp(-2 * (np.pi * SPOT_PX * f) ** 2))

    half = brentq(lambda f: modulation(f) - 0.5, 0.1, 0.9)
    found = psf_width_px(scan(card))
    assert found is not None
    width_px, error_px = found
    assert width_px == pytest.approx(np.sqrt(np.log(2) / 2) / np.pi / half, abs=0.006)
    assert error_px < 0.006


@pytest.mark.parametrize("optics", [PlainOptics(42.7, 2.1, blur_sigma_px=0.2), "petzval_b"])
def test_a_simulated_burst_tells_the_width_that_its_edges_show(optics: PlainOptics | str) -> None:
    traced = optics if isinstance(optics, PlainOptics) else named_optics(optics, 1)
    camera = replace(camera_preset("o3m151"), optics=traced, scatter=None, output="float")
    burst, _ = simulate_tof_burst(named_scene("slanted_edge"), camera, shift_error_px=0.0)
    found = psf_width_px(burst)
    assert found is not None
    assert burst.meta["psf_sigma_px"] == pytest.approx(found[0], abs=0.015)


def test_no_edge_no_width() -> None:
    assert psf_width_px(scan(lambda row, col: 0.5 + 0.2 * np.sin(0.5 * row + 0.4 * col))) is None
