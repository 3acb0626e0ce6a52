"""Frames that shook are told by second derivatives, and do not spoil the picture of the others."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from mosaic import SAMPLES, MosaicBurst, canvas, observe
from numpy.typing import NDArray
from pixel_camera import Array, interior_psnr, make_burst, photograph, truth

from lensshift import Burst, reconstruct
from lensshift.core.errors import QualityWarning
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.belief import refuted
from lensshift.reconstruction.learned.method import _as_they_fit
from lensshift.reconstruction.learned.solver import Asked, solve_together
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import find_misfit
from lensshift.reconstruction.sharpness import as_sharp_as_most, moments_px2

SHAPE = (27, 33)
WIDTH_PX = 12**-0.5


def shaken_burst(
    seed: int, moved_px: dict[int, tuple[float, float]], frames: int = 9, snr: float = 50.0
) -> MosaicBurst:
    """Return frames of a random mosaic, some of which see it move evenly during the exposure.

    Each is the mean of nine exposures along the way: second moment way^2 (1 - 1/81) / 12.
    """
    rng = np.random.default_rng(seed)
    fine, offset = canvas(rng, SHAPE), rng.uniform(-0.5, 0.5, (frames, 2))
    offset = np.round(offset * SAMPLES) / SAMPLES
    seen = observe(fine, SHAPE, offset_px=offset, snr=snr, rng=rng)
    for k, way in moved_px.items():
        places = offset[k] + np.linspace(-0.5, 0.5, 9)[:, None] * np.array(way) * (8 / 9)
        exposures = observe(fine, SHAPE, offset_px=places, snr=1e9, rng=rng)
        seen.y[k] = exposures.y.mean(axis=0) + seen.sigma * rng.standard_normal(SHAPE)
    return seen


def said_of(seen: MosaicBurst) -> tuple[NDArray[np.float64], list[str]]:
    burst = Burst.from_arrays(seen.y, offset_px=seen.offset_px, pitch_mm=0.1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", QualityWarning)
        image = reconstruct(burst, seen.scale, std=False).amplitude.image
    return image, [str(w.message) for w in caught]


def test_moments_of_a_plane_wave_are_those_of_its_contrast() -> None:
    """exp(-2 pi^2 v^T C v) is 1 - 2 pi^2 v^T C v for small C, and all else is exact."""
    row, col = np.mgrid[:54, :66] / 2.0
    wave = np.zeros((54, 66))
    model = forward_model(SHAPE, 2, np.array([[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5], [0.25, 0]]))
    told, y = (0.3, -0.1, 0.4), np.zeros((5, *SHAPE))
    waves = []
    for rows, cols, phase in ((0.03, 0.05, 0.3), (0.06, -0.02, 1.0), (0.01, 0.06, 2.0)):
        loss = told[0] * rows**2 + 2 * told[1] * rows * cols + told[2] * cols**2
        waves.append((2 * np.pi * (rows * row + cols * col) + phase, 1 - 2 * np.pi**2 * loss))
    wave = np.sum([np.cos(angle) for angle, _ in waves], axis=0)
    y[:] = model.predict(wave)
    y[3] = model.predict(np.sum([left * np.cos(angle) for angle, left in waves], axis=0))[3]
    found = moments_px2(model.operator, wave, y, np.full(y.shape, 1e-3), 2)
    assert list(found) == [3]
    assert found[3] == pytest.approx(told, abs=0.05)  # derivatives are differences of neighbours
    sharp = as_sharp_as_most(model.operator, wave, y, 2, found)
    assert np.std((sharp - model.predict(wave))[3]) < 0.15 * np.std((y - model.predict(wave))[3])


def test_a_frame_that_lies_elsewhere_is_as_sharp_as_the_others() -> None:
    """To second order a shift by d looks like one with second moments d d^T."""
    row, col = np.mgrid[:54, :66] / 2.0
    model = forward_model(SHAPE, 2, np.array([[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5], [0.25, 0]]))

    def seen(down_px: float, right_px: float) -> NDArray[np.float64]:
        waves = ((0.03, 0.05, 0.3), (0.06, -0.02, 1.0), (0.01, 0.06, 2.0))
        angles = [a * (row - down_px) + b * (col - right_px) for a, b, _ in waves]
        pairs = zip(angles, waves, strict=True)
        return np.sum([np.cos(2 * np.pi * at + phase) for at, (_, _, phase) in pairs], axis=0)

    y = model.predict(seen(0, 0))
    y[3] = model.predict(seen(0.8, -0.7))[3]
    assert moments_px2(model.operator, seen(0, 0), y, np.full(y.shape, 1e-3), 2) == {}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_frame_that_shook_is_named_and_costs_little(seed: int) -> None:
    moved = {2: (3.0, 0.0), 5: (0.0, 2.6)}
    image, said = said_of(shaken_burst(seed, moved))
    still, nothing = said_of(shaken_burst(seed, {}))
    assert not nothing
    assert len(said) == 1
    for frame, along in ((2, 0), (5, 1)):
        place = said[0].index(f"frame {frame} is less sharp than the others, by (")
        width = said[0][place:].split("(")[1].split(")")[0].split(", ")
        assert float(width[along]) == pytest.approx(max(moved[frame]) / 12**0.5, abs=0.3)
    inner = (slice(6, -6), slice(6, -6))
    truth = shaken_burst(seed, {}).truth
    loss, least = (np.sqrt(np.mean((x - truth)[inner] ** 2)) for x in (image, still))
    assert loss < 1.25 * least


@pytest.mark.parametrize(("doubt", "expected"), [(0.99, []), (1.01, [2])])
def test_frames_are_compared_in_sharpness_as_soon_as_they_contradict(
    doubt: float, expected: list[int]
) -> None:
    seen = shaken_burst(1, {2: (3.0, 0.0)})
    model = forward_model(SHAPE, 2, seen.offset_px, blur=GaussianBlur(WIDTH_PX))
    asked = Asked(model, seen.y, np.full(seen.y.shape, seen.sigma), WIDTH_PX)
    found = solve_together([asked])[0]
    misfit = find_misfit(model.operator, found.image, seen.y, asked.sigma, 2)
    misfit = replace(misfit, doubt=np.full(seen.y.shape, doubt), off_px={}, brightness=0.0)
    run = lambda _: (found, misfit)  # noqa: E731
    shaken = _as_they_fit(asked, found, misfit, run, Request(), lambda sigma: sigma)[-1]
    assert list(shaken) == expected


@pytest.mark.slow
def test_few_frames_tell_of_no_other_and_outliers_are_no_shaking() -> None:
    seen = shaken_burst(4, {1: (3.0, 0.0)}, frames=3)
    model = forward_model(SHAPE, 2, seen.offset_px, blur=GaussianBlur(WIDTH_PX))
    noise = np.full(seen.y.shape, seen.sigma)
    assert moments_px2(model.operator, seen.truth, seen.y, noise, 2) == {}
    rng = np.random.default_rng(0)
    for seed in range(5, 10):
        seen = shaken_burst(seed, {})
        hit = rng.uniform(size=seen.y.shape) < 0.03
        seen.y[hit] = rng.choice([0.0, 1.2], size=hit.sum())
        assert not any("sharp" in message for message in said_of(seen)[1])


def test_noise_that_is_told_too_small_is_refuted_and_the_right_one_is_not() -> None:
    for seed in (11, 12):
        seen = shaken_burst(seed, {})
        model = forward_model(SHAPE, 2, seen.offset_px, blur=GaussianBlur(WIDTH_PX))
        for told, expected in ((1.0, False), (0.5, True)):
            noise = np.full(seen.y.shape, told * seen.sigma)
            asked = Asked(model, seen.y, noise, WIDTH_PX)
            assert refuted(asked, solve_together([asked])[0]) is expected


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22, 23])
def test_frames_that_no_noise_explains_are_followed_as_far_as_they_predict(seed: int) -> None:
    """A camera that compresses: even blocks, as if noise were hardly there, and edges that err."""
    seen = shaken_burst(seed, {}, frames=12)
    rng = np.random.default_rng(seed)
    coarse = np.kron(rng.standard_normal((12, 9, 11)), np.ones((3, 3)))[:, : SHAPE[0], : SHAPE[1]]
    steep = np.hypot(*np.gradient(seen.y, axis=(1, 2)))
    y = seen.y + 0.05 * coarse * (steep > np.median(steep))
    burst = Burst.from_arrays(y, offset_px=seen.offset_px, pitch_mm=0.1)
    inner = (slice(6, -6), slice(6, -6))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        small, right = (
            np.std(
                (reconstruct(burst, 2, std=False, noise_sigma=s).amplitude.image - seen.truth)[
                    inner
                ]
            )
            for s in (seen.sigma / 4, 0.05)
        )
    assert small < 1.3 * right


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_less_noise_never_costs_anything(seed: int) -> None:
    """Hardly any noise is left, and the pixel's response is not quite as told: it is no noise."""
    inner = (slice(6, -6), slice(6, -6))
    errors = []
    for snr in (200.0, 1000.0):
        seen = shaken_burst(seed, {}, frames=12, snr=snr)
        errors.append(np.std((said_of(seen)[0] - seen.truth)[inner]))
    assert errors[1] < 1.05 * errors[0]


@pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")  # some pixels do contradict
@pytest.mark.parametrize("seed", [1, 4])
def test_salt_and_pepper_does_not_take_the_rings_with_it(seed: int) -> None:
    """What is believed of curved detail beside a tenth of wrong pixels, the other frames decide."""

    def rings(row: Array, col: Array) -> Array:
        return 0.5 + 0.4 * np.cos(np.pi * 0.45 / 13 * ((row - 13) ** 2 + (col - 16.5) ** 2))

    rng = np.random.default_rng(seed)
    offset = rng.uniform(-0.5, 0.5, (12, 2))
    y = photograph(rings, (27, 34), offset) + 0.016 * rng.standard_normal((12, 27, 34))
    hit = rng.random(y.shape) < 0.1
    y[hit] = rng.integers(0, 2, hit.sum())
    image = reconstruct(make_burst(y, offset), psf_sigma_px=0.289, std=False).amplitude.image
    assert interior_psnr(image, truth(rings, (27, 34), 2)) > 34.5  # 25.9 and 27.4 before
