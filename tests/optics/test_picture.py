"""The closed form of what a reconstruction leaves, against drawn scenes and limits."""

from typing import Any

import numpy as np
import pytest

from lensshift import Burst, reconstruct
from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.optics.lens_file import load_lens
from lensshift.optics.picture import (
    format_scores,
    linear_picture,
    picture_score,
    traced_frames,
)

SENSOR = Grid((16, 64), (0.155, 0.155))


def linear_rmse(*given: Any, **options: Any) -> float:
    return linear_picture(*given, **options).rmse


def clear(frames: int):  # type: ignore[no-untyped-def]
    return lambda frequency: np.ones((frames, *frequency.shape[:-1]), dtype=complex)


def test_limits() -> None:
    square, dense = named_pattern_px("square"), named_pattern_px("4x4")
    # Sixteen places see all sixteen aliases; without noise nothing is lost.
    assert linear_rmse(dense, clear(16), 1e-9) < 1e-5
    # Drowned in noise the best guess is the mean: the whole scene is lost.
    lost = linear_rmse(square, clear(4), 1e6)
    assert lost == pytest.approx(linear_rmse(square, clear(4), 1e7), rel=1e-6)
    assert 0.8 * 0.2 < lost < 0.2
    errors = [linear_rmse(square, clear(4), 0.005, px) for px in (0.0, 0.01, 0.03, 0.1)]
    assert errors == sorted(errors)
    still = linear_rmse(named_pattern_px("still"), clear(1), 0.0025)
    assert errors[0] < 0.8 * still
    # Whole pixels change nothing, nor does a common shift that the places of the picture share.
    moved = linear_rmse(square + np.array([1.0, -2.0]), clear(4), 0.005, 0.01)
    assert moved == pytest.approx(errors[1], rel=1e-9)
    aside = linear_rmse(square, clear(4), 0.005, 0.01, place_px=0.0)
    assert linear_rmse(square + 0.25, clear(4), 0.005, 0.01) == pytest.approx(aside, rel=1e-9)
    # The mean over all places is that over any four that are a quarter of a pixel apart.
    places = [linear_rmse(square, clear(4), 0.005, place_px=p) ** 2 for p in (0.0, 0.25)]
    mixed = [
        linear_rmse(square + np.array([0.25, 0.0])[::way], clear(4), 0.005) ** 2 for way in (1, -1)
    ]
    everywhere = linear_rmse(square, clear(4), 0.005, place_px=None) ** 2
    assert np.mean([*places, *mixed]) == pytest.approx(everywhere, rel=1e-9)
    contrast = [linear_picture(square, clear(4), noise).mtf for noise in (1e6, 0.1, 0.01, 1e-4)]
    assert contrast == sorted(contrast)
    assert contrast[0] == pytest.approx(0.0, abs=1e-6)
    assert linear_picture(dense, clear(16), 1e-9).mtf == pytest.approx(1.0, abs=1e-4)


def left_by_a_solver(
    offset_px: np.ndarray, error_px: float, place_px: float, noise: float, seed: int
) -> float:
    """Return the mean square error of pixels half the size, of one random periodic scene."""
    side, fine = 22, 4  # the scene has detail up to two cycles per pixel
    rng = np.random.default_rng(seed)
    along = np.fft.fftfreq(side * fine) * fine
    frequency = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
    power = 1.0 / (64.0**-2 + np.sum(frequency**2, axis=-1))
    power[0, 0] = 0.0
    scene = np.fft.fft2(rng.standard_normal(power.shape)) * np.sqrt(power)
    scene *= 0.2 / np.fft.ifft2(scene).real.std()

    def sampled(aperture: float, place: np.ndarray, step: int) -> np.ndarray:
        seen = scene * np.prod(np.sinc(aperture * frequency), axis=-1)
        return np.fft.ifft2(seen * np.exp(2j * np.pi * (frequency @ place))).real[::step, ::step]

    true_px = offset_px + error_px * rng.standard_normal(offset_px.shape)
    frames = np.array([0.5 + sampled(1.0, -shift, fine) for shift in true_px])
    frames += noise * rng.standard_normal(frames.shape)
    burst = Burst.from_arrays(frames, offset_px=offset_px + 0.25 - place_px, pitch_mm=0.155)
    solved = reconstruct(burst, fine, "tikhonov", fill_factor=1.0, psf_sigma_px=0.0,
                         noise_sigma=noise, std=False).amplitude.image  # fmt: skip
    picture = solved.reshape(2 * side, 2, 2 * side, 2).mean(axis=(1, 3))
    truth = 0.5 + sampled(0.5, np.full(2, -place_px), 2)
    return float(np.mean((picture - truth)[8:-8, 8:-8] ** 2))


@pytest.mark.slow
def test_a_solver_leaves_what_the_closed_form_says() -> None:
    """Tikhonov, which knows nothing of the scene's power, over patterns, places and errors."""
    told, got = [], []
    for pattern, place_px in (("square", 0.25), ("square", 0.0), ("3x3", 0.25), ("3x3", 0.0)):
        offset_px = named_pattern_px(pattern)
        noise = 0.005 * np.sqrt(len(offset_px) / 4.0)
        for error_px in (0.0, 0.02):
            otf = clear(len(offset_px))
            told.append(linear_rmse(offset_px, otf, noise, error_px, place_px=place_px))
            squares = [left_by_a_solver(offset_px, error_px, place_px, noise, s) for s in range(4)]
            got.append(np.sqrt(np.mean(squares)))
    ratio = np.array(got) / told
    assert 0.9 < ratio.min() < ratio.max() < 1.12
    assert np.corrcoef(told, got)[0, 1] > 0.97  # 0.98 with the weight that noise alone asks for
    # The same four frames, the pixels of the picture between their pixels instead of on them.
    assert got[2] < 0.6 * got[0]


@pytest.mark.slow
def test_score_prefers_the_element_that_is_less_sensitive() -> None:
    lens = load_lens("petzval_a")
    exact = [picture_score(lens, element, SENSOR, actuator_um=0.0) for element in (0, 1)]
    rough = [picture_score(lens, element, SENSOR, actuator_um=0.5) for element in (0, 1)]
    assert exact[0].rmse == exact[0].rmse_exact
    assert exact[0].rmse == pytest.approx(exact[1].rmse, rel=0.01)
    # What the actuator adds goes with the square of the sensitivity.
    added = [one.rmse**2 - one.rmse_exact**2 for one in rough]
    ratio = (rough[1].shift_error_px / rough[0].shift_error_px) ** 2
    assert added[1] / added[0] == pytest.approx(ratio, rel=0.05)
    assert rough[0].shift_error_px == pytest.approx(0.5 * 0.0056, rel=0.02)
    assert len(format_scores(["a", "b"], rough).splitlines()) == 3
    assert rough[0].mtf < rough[1].mtf
    aside = picture_score(lens, 1, SENSOR, place_px=0.0, actuator_um=0.5)
    assert aside.rmse < 0.6 * rough[1].rmse
    assert "square, aside" in format_scores(["a"], [aside])
    frames = traced_frames(lens, 1, SENSOR, named_pattern_px("square"))
    assert frames.offset_px[:, 0] == pytest.approx(named_pattern_px("square"), abs=1e-4)
    assert frames.otf(0)(np.zeros((1, 1, 2))) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="noise > 0"):
        picture_score(lens, 0, SENSOR, noise=0.0)
