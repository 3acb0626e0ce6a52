"""What a JPEG cuts off an edge, in closed form and in coded images."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.fft import dctn
from scipy.ndimage import correlate
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge import measure_edge
from lensshift.evaluation.slanted_edge.compression import lost_std
from lensshift.evaluation.slanted_edge.noise_model import NoiseModel, with_edge

Floats = NDArray[np.float64]
pytestmark = pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
FLAT = np.full((8, 8), 0.05)
PLACES = np.array([0.0, 0.2, 0.4])
ALONG_ROWS = np.array([0.0, 1.0])


def modulation(frequency_cpp: float, sigma_px: float) -> float:
    return float(np.exp(-2.0 * (np.pi * sigma_px * frequency_cpp) ** 2))


@pytest.mark.parametrize("order", [2, 3, 5])
def test_the_loss_is_a_rounding_error_of_the_largest_coefficient(order: int) -> None:
    """Of a sampled edge, transformed by scipy: a modulation of q / A of it is one step."""
    places, sigma_px, frequency_cpp = np.arange(8) - 3.5, 0.8, order / 16.0
    blocks = [np.tile(ndtr((places - shift) / sigma_px), (8, 1)) for shift in np.arange(-2, 2, 0.1)]
    largest = max(abs(dctn(block, norm="ortho")[0, order]) for block in blocks)
    seen = modulation(frequency_cpp, sigma_px)
    # So little modulation that the coefficient lies within a step.
    told = lost_std(np.array([frequency_cpp]), np.array([0.0]), FLAT, ALONG_ROWS, 0.0)
    half_step = 0.5 * FLAT[0, 0] * seen / largest
    # The errors of a half step to both sides, evenly spread: over the root of 3.
    assert told[0] == pytest.approx(half_step / np.sqrt(3.0), rel=0.1)


def test_noise_and_many_steps_dither_the_loss() -> None:
    frequency_cpp = np.array([0.3])
    quiet, loud = (
        lost_std(frequency_cpp, np.array([0.0]), FLAT, ALONG_ROWS, noise)[0]
        for noise in (0.0, FLAT[0, 0])
    )
    strong = lost_std(frequency_cpp, np.array([1.0]), FLAT, ALONG_ROWS, 0.0)[0]
    assert loud < 1e-6 * quiet
    assert strong < 0.5 * quiet


def test_the_direction_of_the_normal_picks_the_steps() -> None:
    steps = FLAT.copy()
    steps[:, 4:] *= 3.0
    told = [
        lost_std(np.array([5.0 / 16.0]), np.array([0.0]), steps, normal, 0.0)[0]
        for normal in (ALONG_ROWS, ALONG_ROWS[::-1])
    ]
    assert told[0] == pytest.approx(3.0 * told[1])


def sharpened_jpeg(seed: int) -> tuple[Floats, Floats, Floats]:
    """Return a sharpened edge out of a JPEG, its table, and its MTF at PLACES."""
    rng = np.random.default_rng(seed)
    angle, sigma_px = np.deg2rad(rng.uniform(2.5, 6.0)), rng.uniform(0.55, 0.8)
    row, col = (np.arange(n) - (n - 1) / 2.0 for n in (88, 72))
    normal = col * np.cos(angle) + row[:, None] * np.sin(angle) - rng.uniform(-3.0, 3.0)
    values = 80.0 + 90.0 * (ndtr(normal / sigma_px) + 0.003 * rng.standard_normal((88, 72)))
    reach = np.arange(-4, 5)
    wide = np.exp(-0.5 * (reach / 1.2) ** 2)
    mask = -np.outer(wide, wide) / wide.sum() ** 2
    mask[4, 4] += 2.0
    stream = io.BytesIO()
    sharp = correlate(values, mask, mode="nearest")
    Image.fromarray(np.rint(sharp).astype(np.uint8)).save(stream, "JPEG", quality=85)
    coded = Image.open(stream)
    turn = reach * np.cos(angle) + reach[:, None] * np.sin(angle)
    by_mask = np.tensordot(mask, np.cos(2.0 * np.pi * np.multiply.outer(turn, PLACES)), 2)
    curve = np.abs(by_mask) * np.exp(-2.0 * (np.pi * sigma_px * PLACES) ** 2)
    cut = np.asarray(coded, dtype=np.float64)[8:-8, 8:-8]
    return cut, np.array(coded.quantization[0]).reshape(8, 8), curve


@pytest.mark.slow
def test_the_intervals_of_sharpened_jpegs_hold_the_truth() -> None:
    """Of the curve at 0.2 and 0.4 cycles a pixel, one in fourteen does not without the table."""
    missed = np.zeros(2)
    for seed in range(14):
        image, steps, curve = sharpened_jpeg(seed)
        region = (0, image.shape[0], 0, image.shape[1])
        for k, known in enumerate((None, steps)):
            found = measure_edge(image, region=region, frequency_lpmm=PLACES, jpeg_steps=known)
            low, high = np.asarray(found.low), np.asarray(found.high)
            missed[k] += np.mean(((curve < low) | (curve > high))[1:]) / 14
    plain, told = missed
    assert told < 0.05 < plain


@pytest.mark.parametrize("steps", [np.ones(64), np.zeros((8, 8)), np.full((8, 8), np.nan)])
def test_what_is_no_table_of_steps_is_refused(steps: Floats) -> None:
    image = sharpened_jpeg(0)[0]
    with pytest.raises(ValueError, match=r"positive jpeg_steps \[8 8\]"):
        measure_edge(image, jpeg_steps=steps)


def test_noise_near_an_edge_is_its_own_where_none_is_left_far_out() -> None:
    """Blocks without the edge are flat in JPEGs of little noise; its variance was taken over 0."""
    row, col = (index.ravel() for index in np.indices((48, 70)))
    away = np.abs(col - 34.5)
    sigma = np.where(away < 6.0, 3e-3, np.where(away < 12.0, 5e-4, 1e-7))
    residual = sigma * np.random.default_rng(2).standard_normal(row.size)
    plateaus = NoiseModel(3e-4, 3e-4, 0, np.zeros(0))
    places = np.column_stack([np.zeros_like(row), row, col])
    noise = with_edge(plateaus, residual, (col > 34.5).astype(float), col - 34.5, places)
    assert noise.near is not None
    told = noise.dark_sigma * noise.relative_sigma((col > 34.5).astype(float), col - 34.5)
    assert np.mean(told[away < 4.0]) == pytest.approx(3e-3, rel=0.3)
    assert np.mean(told[away > 13.0]) == pytest.approx(3e-4, rel=0.01)
    whitened = noise.whitener(places, told / noise.dark_sigma, col - 34.5) @ residual
    assert np.sqrt(np.mean(whitened**2)) < 2.0 * noise.dark_sigma
    assert np.sqrt(np.mean(whitened[away < 4.0] ** 2)) > 0.5 * noise.dark_sigma
