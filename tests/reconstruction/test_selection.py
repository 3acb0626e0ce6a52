"""The weight of a prior, found without the truth."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, edge_scene, interior_psnr, photograph, truth

from lensshift.core.types import Burst
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.least_squares import NEIGHBOURS, solve_penalised
from lensshift.forward.model import forward_model
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.losses import Squares
from lensshift.reconstruction.priors import (
    BilateralTotalVariation,
    Prior,
    SparseDifferences,
    TotalVariation,
)
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.reconstruction.selection import cross_validate, predicting_weight, prior_share
from lensshift.reconstruction.solver import MaximumAPosteriori, Reweighted

SHAPE = (14, 18)


@pytest.fixture(scope="module")
def A() -> LinearOperator:
    return forward_model(SHAPE, 2, SQUARE_PX, blur=GaussianBlur(0.3)).operator


@pytest.fixture(scope="module")
def y() -> np.ndarray:
    frames = photograph(edge_scene, SHAPE, SQUARE_PX)
    return frames + 0.02 * np.random.default_rng(5).standard_normal(frames.shape)


def _solver(A: LinearOperator, y: np.ndarray):
    def solve(value: float, weight: np.ndarray) -> np.ndarray:
        even = np.full((len(NEIGHBOURS), *A.in_shape), value)
        return solve_penalised(A, y, weight, even, np.zeros(A.in_shape), 100)

    return solve


def test_cross_validation_is_neither_far_too_soft_nor_too_stiff(
    A: LinearOperator, y: np.ndarray
) -> None:
    solve, ones = _solver(A, y), np.ones(y.shape)
    expected = truth(edge_scene, SHAPE, 2)
    chosen = cross_validate(solve, A, y, ones, seed=0)
    by_weight = [interior_psnr(solve(10.0**e, ones), expected) for e in (-6, -3, -2, -1.5, -1, 0)]
    found = interior_psnr(solve(chosen, ones), expected)
    assert 1e-5 < chosen < 0.5
    assert found > max(by_weight) - 2.5
    assert found > by_weight[0] + 3.0
    assert found > by_weight[-1] + 3.0


@pytest.mark.parametrize("exponent", [-5.7, -4.45, -2.0, -1.4, -0.37, 0.0])
def test_cross_validation_ends_within_half_a_ninth_of_a_decade(
    A: LinearOperator, exponent: float
) -> None:
    def solve(value: float, weight: np.ndarray) -> np.ndarray:
        return np.full(A.in_shape, 0.1 + abs(np.log10(value) - exponent))

    black = np.zeros((4, *SHAPE))
    chosen = cross_validate(solve, A, black, black + 1.0, 0)
    assert abs(np.log10(chosen) - exponent) <= 1 / 18 + 1e-6


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("away", [0.78, 0.67, 0.55])
def test_cross_validation_finds_the_best_ninth_beyond_the_best_decade(
    A: LinearOperator, away: float, sign: int
) -> None:
    """Where the error rises steeply on one side, the nearest decade is not the best."""

    def score(exponent: float) -> float:
        beyond = sign * (exponent + 3) - away
        return 0.1 + max(4 * beyond, -beyond)

    def solve(value: float, weight: np.ndarray) -> np.ndarray:
        return np.full(A.in_shape, score(np.log10(value)))

    black = np.zeros((4, *SHAPE))
    chosen = cross_validate(solve, A, black, black + 1.0, 0)
    best = min(score(-3 + ninth / 9) for ninth in range(-9, 10))
    assert score(np.log10(chosen)) == pytest.approx(best, abs=1e-4)


def test_cross_validation_follows_the_seed_alone(A: LinearOperator, y: np.ndarray) -> None:
    solve, ones = _solver(A, y), np.ones(y.shape)
    assert cross_validate(solve, A, y, ones, 3) == cross_validate(solve, A, y, ones, 3)


def test_cross_validation_reports_trials_and_never_trains_on_held_out_pixels(
    A: LinearOperator, y: np.ndarray
) -> None:
    trials: list[int] = []
    masks: list[np.ndarray] = []
    ones = np.ones(y.shape)
    ones[0, 0, 0] = 0.0

    def solve(value: float, weight: np.ndarray) -> np.ndarray:
        masks.append(weight.copy())
        return np.full(A.in_shape, 0.5)

    cross_validate(solve, A, y, ones, 1, lambda number, score: trials.append(number))
    assert trials == list(range(1, len(masks) + 1))
    assert all(np.array_equal(mask, masks[0]) for mask in masks)
    share = np.mean(masks[0] == 0.0)
    assert 0.05 < share < 0.16
    assert masks[0][0, 0, 0] == 0.0


def test_cross_validation_without_usable_pixels_says_what_to_do(
    A: LinearOperator, y: np.ndarray
) -> None:
    with pytest.raises(ValueError, match="prior_weight a number"):
        cross_validate(_solver(A, y), A, y, np.zeros(y.shape), 0)


def test_the_weight_from_noise_is_the_scale_of_the_prior() -> None:
    # A prior of degree p that is the p-th power of Laplacian-like differences of size s: P = N s^p.
    x = np.indices((9, 11)).sum(axis=0) * 0.1
    for prior, p in ((BilateralTotalVariation(1, 0.5, 1e-6), 1.0), (SparseDifferences(2.0), 2.0)):
        once, twice = (MaximumAPosteriori(0.01)(prior, scale * x) for scale in (1.0, 2.0))
        assert once == pytest.approx(0.01 * x.size / (p * prior.value(x)))
        assert once / twice == pytest.approx(2.0**p, rel=1e-3)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("prior", [TotalVariation(0.05), SparseDifferences(2.0)])
def test_the_weight_of_a_picture_is_the_one_that_the_picture_asks_for(
    A: LinearOperator, prior: Prior, seed: int
) -> None:
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    y += 0.02 * np.random.default_rng(seed).standard_normal(y.shape)
    rule = MaximumAPosteriori(0.45 * 2 * 0.02**2)
    found = Reweighted(Squares(), prior, rule, 0.02, inner_iterations=20)(A, y, np.ones(y.shape))
    assert found.prior_weight == pytest.approx(rule(prior, found.image), rel=0.02)


def test_a_wider_blur_hides_more_of_the_differences() -> None:
    shares = [prior_share(blur) for blur in (0.3, 0.6, 1.2)]
    assert shares == sorted(shares, reverse=True)
    assert prior_share(0.0) == prior_share(0.3)
    assert prior_share(1.0) == pytest.approx(0.45)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("sigma", [0.2, 0.02])
def test_the_predicting_weight_leaves_what_noise_is(
    A: LinearOperator, sigma: float, seed: int
) -> None:
    y = photograph(edge_scene, SHAPE, SQUARE_PX)
    y += sigma * np.random.default_rng(seed).standard_normal(y.shape)
    solve, ones = _solver(A, y), np.ones(y.shape)

    def at(value: float, frames: np.ndarray) -> np.ndarray:
        return _solver(A, frames)(value, ones)

    chosen = predicting_weight(at, A, y, ones, 10.0, sigma)
    left, before = (
        np.mean((y - A.forward(solve(one, ones))) ** 2) for one in (chosen, chosen * 10**0.5)
    )
    assert left <= sigma**2 < before or chosen == 10.0
    expected = truth(edge_scene, SHAPE, 2)
    best = max(interior_psnr(solve(10.0**e, ones), expected) for e in np.arange(-5, 1, 0.25))
    assert interior_psnr(solve(chosen, ones), expected) > best - 3.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_that_is_told_too_small_does_not_let_the_picture_follow_it(
    A: LinearOperator, seed: int
) -> None:
    """With 16 frames at x2 a picture leaves three quarters of the noise, whatever the weight."""
    offset_px = np.random.default_rng(seed).uniform(-0.5, 0.5, (16, 2))
    A = forward_model(SHAPE, 2, offset_px, blur=GaussianBlur(0.3)).operator
    y = photograph(edge_scene, SHAPE, offset_px)
    y += 0.2 * np.random.default_rng(seed).standard_normal(y.shape)
    ones = np.ones(y.shape)

    def at(value: float, frames: np.ndarray) -> np.ndarray:
        return _solver(A, frames)(value, ones)

    expected = truth(edge_scene, SHAPE, 2)
    right, wrong = (
        interior_psnr(at(predicting_weight(at, A, y, ones, 10.0, sigma), y), expected)
        for sigma in (0.2, 0.1)
    )
    assert wrong > right - 1.0
    assert interior_psnr(at(1e-6, y), expected) < right - 3.0


def test_the_predicting_weight_of_complex_frames_is_that_of_their_parts(A: LinearOperator) -> None:
    rng = np.random.default_rng(0)
    y = photograph(edge_scene, SHAPE, SQUARE_PX)

    def at(value: float, frames: np.ndarray) -> np.ndarray:
        parts = [_solver(A, part)(value, np.ones(y.shape)) for part in (frames.real, frames.imag)]
        return parts[0] + 1j * parts[1] if frames.dtype.kind == "c" else parts[0]

    one, two = y + 0.1 * rng.standard_normal((2, *y.shape))
    both = predicting_weight(at, A, one + 1j * two, np.ones(y.shape), 10.0, 0.1)
    alone = [predicting_weight(at, A, part, np.ones(y.shape), 10.0, 0.1) for part in (one, two)]
    assert min(alone) / 4 < both < max(alone) * 4


@pytest.mark.parametrize("halves", range(-6, 8))
def test_the_predicting_weight_is_where_exact_cross_validation_is_least(halves: int) -> None:
    """A scene in half of the pixels, noise in all, and a filter that spares the scene.

        V = 2 (S a^2 + s^2 b^2) / (a + b)^2,   a = 1 / (1 + lambda),  b = 1 / (r + lambda)

    is least where s^2 (1 + lambda) = S (r + lambda): at 0.1 for S = 10 s^2 and r = 0.01.
    """
    rng, size = np.random.default_rng(halves + 6), (400, 600)
    scene = np.arange(size[1]) < size[1] // 2
    y = rng.standard_normal((1, *size)) * np.where(scene, 10**0.5, 1.0)
    A = LinearOperator(size, (1, *size), lambda x: x[None], lambda z: z[0])

    def solve(value: float, frames: np.ndarray) -> np.ndarray:
        return frames[0] * np.where(scene, 1 / (1 + value), 1 / (1 + value / 0.01))

    start = 0.1 * 10 ** (halves / 2)
    chosen = predicting_weight(solve, A, y, np.ones(y.shape), start, 1e-9)
    assert chosen == pytest.approx(0.1)


METHODS = ["tikhonov", "tv", "l1-btv", "map", "irwsr"]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("sigma", [0.1, 0.01])
def test_no_method_blurs_a_scene_away_in_noise(method: str, sigma: float, seed: int) -> None:
    """Two frames show little, and a prior that believes its own picture ends with none."""
    rng = np.random.default_rng(seed)
    offset_px = rng.uniform(-0.5, 0.5, (2, 2))
    frames = photograph(edge_scene, (20, 20), offset_px)
    frames += sigma * rng.standard_normal(frames.shape)
    burst = Burst.from_arrays(frames, offset_px=offset_px, pitch_mm=0.1)
    expected = truth(edge_scene, (20, 20), 2)

    def quality(weight: float | None) -> float:
        found = reconstruct(
            burst, 2, method, psf_sigma_px=0.289, prior_weight=weight, std=False
        ).amplitude
        assert found is not None
        return interior_psnr(found.image, expected)

    assert quality(None) > max(quality(10.0**e) for e in range(-5, 1)) - 2.5


@pytest.mark.parametrize(("count", "scale", "seed"), [(4, 2, 0), (6, 3, 0), (6, 3, 1)])
def test_without_noise_a_picture_is_not_made_of_what_the_model_leaves(
    count: int, scale: int, seed: int
) -> None:
    """Of a picture full of amplified errors the prior asks less and less."""
    rng = np.random.default_rng(seed)
    offset_px = rng.uniform(-0.5, 0.5, (count, 2))
    frames = photograph(edge_scene, (20, 20), offset_px)
    frames += 0.001 * rng.standard_normal(frames.shape)
    burst = Burst.from_arrays(frames, offset_px=offset_px, pitch_mm=0.1)
    expected = truth(edge_scene, (20, 20), scale)

    def quality(weight: float | None) -> float:
        found = reconstruct(
            burst, scale, "tikhonov", psf_sigma_px=0.289, prior_weight=weight, std=False
        ).amplitude
        assert found is not None
        return interior_psnr(found.image, expected)

    assert quality(None) > max(quality(10.0**e) for e in range(-4, 1)) - 1.5
