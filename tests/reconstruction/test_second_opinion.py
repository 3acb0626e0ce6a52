"""What the weights for brightness add to phasors: texture and steps, if the frames say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, edge_scene, make_burst, photograph, truth
from scipy.ndimage import binary_dilation

from lensshift import reconstruct
from lensshift.core.units import distance_to_phase
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.opinions import (
    PHASE_STD_SCALE,
    TRUST,
    amplitude_of_both,
    phase_of_both,
)
from lensshift.reconstruction.learned.phasors import (
    LOW_PASS_PX,
    _second_amplitude,
    _second_phase,
    finished,
    mean_hr_px,
    with_means_of,
)
from lensshift.reconstruction.learned.solver import Asked, Solution, solve_together

SHAPE, INSIDE = (25, 38), (slice(5, -5), slice(5, -5))
F_HZ, AWAY_M = 15e6, 3.3


def rings(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Up to 0.8 cycles per LR pixel at 16 px from the middle."""
    return 0.5 + 0.4 * np.cos(np.pi * 0.05 * ((row - 11.7) ** 2 + (col - 18.4) ** 2))


@pytest.mark.parametrize(("snr", "seed"), [(30, 1), (100, 2), (100, 3)])
def test_texture_of_a_surface_is_as_fine_as_without_its_distance(snr: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = photograph(rings, SHAPE, SQUARE_PX)
    noise = rng.normal(scale=1 / snr, size=(2, *clean.shape))
    phasor = clean + noise[0] + 1j * noise[1]
    per_m = distance_to_phase(1.0, F_HZ)
    burst = make_burst(
        np.abs(phasor), distance_m=AWAY_M + np.angle(phasor) / per_m, modulation_hz=F_HZ
    )
    true = truth(rings, SHAPE, 2)

    def error(channel: str) -> float:
        found = reconstruct(burst, channel=channel).amplitude
        assert np.mean(np.abs(found.image - true)[INSIDE] < 2 * found.std[INSIDE]) > 0.9
        return float(np.sqrt(np.mean((found.image - true)[INSIDE] ** 2)))

    assert error("auto") < 1.15 * error("amplitude")  # 3 to 4 times as much without it


@pytest.mark.parametrize(("snr", "seed"), [(15, 4), (50, 5), (50, 7)])
def test_relief_of_one_brightness_is_as_fine_as_its_distances_alone(snr: float, seed: int) -> None:
    """Of decimetres, where phases are as good a mean as phasors."""
    rng, per_m = np.random.default_rng(seed), distance_to_phase(1.0, F_HZ)
    clean = photograph(rings, SHAPE, SQUARE_PX) * 0.4 * per_m
    noise = rng.normal(scale=1 / snr, size=(2, *clean.shape))
    phasor = np.exp(1j * clean) + noise[0] + 1j * noise[1]
    burst = make_burst(
        np.abs(phasor), distance_m=AWAY_M + np.angle(phasor) / per_m, modulation_hz=F_HZ
    )
    true = AWAY_M + 0.4 * truth(rings, SHAPE, 2)

    def error(channel: str) -> float:
        found = reconstruct(burst, channel=channel).distance_m.image
        return float(np.sqrt(np.mean((found - true)[INSIDE] ** 2)))

    assert error("auto") < 1.05 * error("distance")  # 1.3 to 2.6 times as much without it


def asked_of(x: np.ndarray, sigma: float, seed: int = 4) -> Asked:
    """Return frames of phasors [row col]."""
    model = forward_model(SHAPE, 2, SQUARE_PX, blur=GaussianBlur(0.25))
    noise = np.random.default_rng(seed).normal(scale=sigma, size=(2, 4, *SHAPE))
    y = model.operator(x.astype(complex)) + noise[0] + 1j * noise[1]
    return Asked(model, y, np.full(y.shape, sigma), 0.25)


def solution(image: np.ndarray, std: float) -> Solution:
    return Solution(image, np.full(image.shape, std), np.ones((4, *SHAPE), np.float32), 0.0)


@pytest.mark.parametrize("spoilt", [False, True])
def test_the_frames_say_which_amplitudes_are_right(spoilt: bool) -> None:
    true = truth(rings, SHAPE, 2)
    asked = asked_of(true, 0.01)
    right = solve_together([replace(asked, y=asked.y.real)])[0].image
    first, other = (right, 0.5 + 0 * true) if spoilt else (0.5 + 0 * true, right)
    ratio, _ = _second_amplitude(
        asked, first.astype(complex), np.full(true.shape, 0.01), 2, lambda _: solution(other, 0.01)
    )
    np.testing.assert_allclose((ratio * first)[INSIDE], right[INSIDE], atol=0.02)


@pytest.mark.parametrize("spoilt", [False, True])
def test_the_frames_say_which_phases_are_right(spoilt: bool) -> None:
    right, soft = 0.8 * truth(rings, SHAPE, 2), np.full((50, 76), 0.4)
    asked = asked_of(0.7 * np.exp(1j * right), 0.005)
    first, other = (right, soft) if spoilt else (soft, right)
    image = 0.7 * np.exp(1j * first)
    phase, _ = _second_phase(
        asked, image, np.full(right.shape, 0.01), 2, lambda _: solution(other, 0.01)
    )
    np.testing.assert_allclose(phase[INSIDE], right[INSIDE], atol=0.03)


@pytest.mark.parametrize("dark", [0.05, 1.0])
def test_frames_of_a_right_picture_are_means_of_its_phases_whatever_their_light(
    dark: float,
) -> None:
    """Light falls to a twentieth at a step: there the phase of a mean is no mean of phases."""
    step = truth(edge_scene, SHAPE, 2)
    light, phase = dark + (1 - dark) * step, 0.9 * step
    asked, seen = asked_of(light * np.exp(1j * phase), 0.0), []
    asked = replace(asked, sigma=np.full(asked.y.shape, 0.002))

    def as_asked(given: Asked) -> Solution:
        seen.append(given)
        return solution(phase, 0.01)

    mean, std = _second_phase(
        asked, light * np.exp(1j * phase), np.full(phase.shape, 0.01), 2, as_asked
    )
    A = asked.model.operator
    np.testing.assert_allclose(seen[0].y, A(phase), atol=1e-5)
    np.testing.assert_allclose(seen[0].sigma, 0.002 / np.abs(asked.y), rtol=1e-4)
    np.testing.assert_allclose(mean, phase, atol=1e-9)
    at_step = np.abs(step - 0.5) < 0.29
    beside = ~binary_dilation(at_step, iterations=4)
    assert (np.median(std[at_step]) > 1.1 * np.median(std[beside])) == (dark < 1)


def test_phases_that_lie_a_turn_apart_are_one() -> None:
    phase = np.full((50, 76), 3.1)
    asked = asked_of(np.exp(1j * (phase + 0.05)), 0.01)
    mean, _ = _second_phase(
        asked, np.exp(1j * phase), np.full(phase.shape, 1e3), 2,
        lambda _: solution(phase - 2 * np.pi + 0.05, 0.01),
    )  # fmt: skip
    np.testing.assert_allclose(mean, phase + 0.05, atol=1e-4)


def test_two_amplitudes_count_as_they_are_sure_and_likely_and_tell_their_difference() -> None:
    def both(*facts: float) -> tuple[float, float]:
        mean, std = amplitude_of_both(*(np.array([n]) for n in facts))
        return float(mean[0]), float(std[0])

    mean, std = both(0.9, 1.1, 0.3, 0.1, 0.0)
    assert mean == pytest.approx(0.25 * 0.9 + 0.75 * 1.1)
    assert std < both(0.9, 1.5, 0.3, 0.1, 0.0)[1]
    np.testing.assert_allclose(both(9.0, 11.0, 3.0, 1.0, 0.0), (10 * mean, 10 * std), rtol=1e-5)
    nine_to_one = np.log(9.0) / TRUST
    assert both(0.9, 1.1, 0.2, 0.2, nine_to_one)[0] == pytest.approx(0.1 * 0.9 + 0.9 * 1.1)


def test_two_phases_count_as_they_are_sure_and_likely_whatever_the_unit() -> None:
    def weight_and_std(first_rad: float, bias_rad: float, evidence: float, of: float = 1.0):
        facts = (0.1 * of, 0.3 * of, first_rad * of, 0.05 * of, bias_rad * of, evidence)
        mean, std = phase_of_both(*(np.array([n]) for n in facts))
        return (mean[0] / of - 0.1) / 0.2, std[0] / of

    alike, std = weight_and_std(0.05, 0.05, 0.0)
    assert alike == pytest.approx(0.5, abs=1e-3)
    assert 0.5 < std / (0.05 * PHASE_STD_SCALE) < 1.0  # a mean of two is surer than each
    assert weight_and_std(0.1, 0.05, 0.0)[0] == pytest.approx(0.8, abs=1e-3)
    assert weight_and_std(0.05, 0.2, 0.0)[0] < 0.4  # phases that are no means of phases
    assert weight_and_std(0.05, 0.05, 30.0)[0] > 0.95
    assert weight_and_std(0.05, 0.05, -30.0)[0] < 0.05
    np.testing.assert_allclose(
        weight_and_std(0.1, 0.2, 3.0, of=10.0 / np.pi), weight_and_std(0.1, 0.2, 3.0), rtol=1e-3
    )


@pytest.mark.parametrize("scale", [2, 3])
def test_means_of_a_picture_are_those_of_the_frames_with_the_noise_of_so_many(scale: int) -> None:
    """A picture that is off by a slow wave, where no frame is."""
    rng, shape, sigma = np.random.default_rng(scale), (60, 75), 0.05
    line = (np.arange(scale) - (scale - 1) / 2) / scale
    offset_px = np.array([(a, b) for a in line for b in line])
    A = forward_model(shape, scale, offset_px, blur=GaussianBlur(0.25)).operator
    true = np.full(A.in_shape, 0.8 * np.exp(0.7j))
    noise = rng.standard_normal((2, *A.out_shape))
    y, weight = A(true) + sigma * (noise[0] + 1j * noise[1]), np.full(A.out_shape, sigma**-2)
    off = 0.3 * np.exp(1j * np.arange(A.in_shape[1]) / (20 * scale)) + np.zeros(A.in_shape)
    image, std = with_means_of(A, true + off, y, weight, LOW_PASS_PX * scale)
    inner = np.s_[6 * scale : -6 * scale, 6 * scale : -6 * scale]
    error = (image - true)[inner]
    for part in (error.real, error.imag):
        assert np.sqrt(np.mean(part**2)) == pytest.approx(np.median(std[inner]), rel=0.25)
    expected = sigma / np.sqrt(mean_hr_px(scale) * len(offset_px) / scale**2)
    np.testing.assert_allclose(std[inner], expected, rtol=0.05)


@pytest.mark.parametrize("seed", [0, 3])
def test_light_drawn_out_of_reach_takes_the_distance_of_what_it_looks_like(seed: int) -> None:
    """A dark wall beside a bright box; along the box pixels of the wall are drawn half a turn off.

    The frames know no such phase, and the pixels as good as no light. Theirs is that of the wall.
    """
    rng, near, wall = np.random.default_rng(seed), 0.4, 0.9
    left = np.broadcast_to(np.arange(26) < 12, (18, 26))
    image = np.where(left, np.exp(1j * near), 0.04 * np.exp(1j * wall))
    offset_px = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])
    model = forward_model((9, 13), 2, offset_px=offset_px, blur=GaussianBlur(0.25))
    y = model.operator.forward(image) + 0.001 * (rng.normal(size=(2, 4, 9, 13)).T @ [1, 1j]).T
    drawn, std = image.copy(), np.full((3, 18, 26), 0.004)
    off = np.zeros(left.shape, np.bool_)
    off[4:14:3, 12] = True
    drawn[off], std[:2, off] = 0.02 * np.exp(1j * (wall + 2.8)), 0.02
    asked = Asked(model, y, np.full(y.shape, 0.001), 0.25)
    answers = iter([(np.abs(drawn), std[0]), (np.zeros(off.shape), np.full(off.shape, 1e6))])

    def second(other: Asked) -> Solution:  # the same light, and no phase
        picture, of_it = next(answers)
        return Solution(picture, of_it, np.ones(y.shape), 0.0)

    found = finished(asked, Solution(drawn, std, np.ones(y.shape), 0.0), 2, second)
    assert np.all(np.abs(np.angle(found.image * np.exp(-1j * wall)))[off] < 0.1)
