"""The error map against what the noise really does."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_camera import (
    SQUARE_PX,
    Scene,
    edge_scene,
    make_burst,
    photograph,
    smooth_scene,
    truth,
)

from lensshift.reconstruction.problem import _own_error_px
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.reconstruction.uncertainty import PropagatedStd

SHAPE, SIGMA = (12, 18), 0.02
INSIDE = (slice(3, -3), slice(3, -3))


def _even_scene(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    return np.full(np.broadcast_shapes(row.shape, col.shape), 0.5)


def _clean() -> np.ndarray:
    return photograph(edge_scene, SHAPE, SQUARE_PX)


def _spread(method: str, draws: int, **settings: object) -> np.ndarray:
    """Standard deviation of the image over independent noise draws."""
    rng = np.random.default_rng(77)
    clean = _clean()
    images = []
    for _ in range(draws):
        burst = make_burst(clean + SIGMA * rng.standard_normal(clean.shape))
        found = reconstruct(burst, method=method, std=False, **settings).amplitude
        images.append(found.image)
    return np.std(images, axis=0, ddof=1)


def _claimed(method: str, bursts: int, **settings: object) -> np.ndarray:
    """Mean over a few bursts of the standard deviation that the estimate states."""
    rng = np.random.default_rng(5)
    clean = _clean()
    stds = []
    for _ in range(bursts):
        burst = make_burst(clean + SIGMA * rng.standard_normal(clean.shape))
        stds.append(reconstruct(burst, method=method, **settings).amplitude.std)
    return np.mean(stds, axis=0)


def test_std_of_tikhonov_agrees_with_monte_carlo() -> None:
    settings = {"prior_weight": 0.02, "noise_sigma": SIGMA}
    spread = _spread("tikhonov", 120, **settings)[INSIDE]
    claimed = _claimed("tikhonov", 1, **settings)[INSIDE]
    assert np.sqrt(np.mean((claimed / spread - 1.0) ** 2)) < 0.15


@pytest.mark.parametrize("method", ["tv", "l1-btv", "map", "irwsr"])
@pytest.mark.parametrize("scene", [edge_scene, smooth_scene, _even_scene])
def test_std_of_reweighted_methods_is_the_spread_of_their_answers(
    scene: Scene, method: str
) -> None:
    """Of even scenes all pixels move together, which a few steps from the answer do not show."""
    rng = np.random.default_rng(3)
    clean = photograph(scene, SHAPE, SQUARE_PX)
    bursts = [make_burst(clean + SIGMA * rng.standard_normal(clean.shape)) for _ in range(25)]
    same = {"method": method, "noise_sigma": SIGMA, "psf_sigma_px": 0.3}
    same["prior_weight"] = reconstruct(bursts[0], std=False, **same).amplitude.prior_weight
    found = [reconstruct(burst, **same).amplitude for burst in bursts]
    spread = np.sqrt(np.mean(np.var([one.image for one in found], axis=0, ddof=1)))
    claimed = np.sqrt(np.mean([one.std**2 for one in found[:2]]))
    assert claimed == pytest.approx(spread, rel=0.35)


@pytest.mark.parametrize("method", ["tikhonov", "map"])
def test_std_is_that_of_the_variances_that_were_told(method: str) -> None:
    rng = np.random.default_rng(4)
    clean = photograph(smooth_scene, SHAPE, SQUARE_PX)
    sigma = np.where(np.arange(SHAPE[1]) < 9, 0.005, 0.03) * np.ones(clean.shape)
    same = {"method": method, "pixel_variance": sigma**2, "psf_sigma_px": 0.3, "prior_weight": 0.01}
    found = [
        reconstruct(make_burst(clean + sigma * rng.standard_normal(clean.shape)), **same).amplitude
        for _ in range(30)
    ]
    spread = np.std([one.image for one in found], axis=0, ddof=1)
    for half in (slice(2, 15), slice(21, -2)):
        claimed, expected = (np.sqrt(np.mean(s[:, half] ** 2)) for s in (found[0].std, spread))
        assert claimed == pytest.approx(expected, rel=0.25)


def test_std_of_shift_and_add_agrees_with_monte_carlo() -> None:
    spread = _spread("shift-and-add", 120)[INSIDE]
    claimed = _claimed("shift-and-add", 1, noise_sigma=SIGMA)[INSIDE]
    assert np.sqrt(np.mean((claimed / spread - 1.0) ** 2)) < 0.15


@pytest.mark.parametrize("scene", [edge_scene, smooth_scene])
def test_std_of_auto_is_that_of_the_error_and_below_the_noise_of_a_pixel(scene: Scene) -> None:
    """It is right in the mean over worlds; scenes as plain as these err less than it says."""
    rng = np.random.default_rng(5)
    clean, true = photograph(scene, SHAPE, SQUARE_PX), truth(scene, SHAPE, 2)
    errors, stds = [], []
    for _ in range(4):
        burst = make_burst(clean + SIGMA * rng.standard_normal(clean.shape))
        found = reconstruct(burst, method="auto").amplitude
        errors.append((found.image - true)[INSIDE])
        stds.append(found.std[INSIDE])
    error, std = (float(np.sqrt(np.mean(np.square(part)))) for part in (errors, stds))
    assert error < std < SIGMA
    assert np.mean(np.abs(errors) < 2 * np.array(stds)) > 0.95


def test_noise_gain_is_the_rms_of_the_std_over_the_noise() -> None:
    rng = np.random.default_rng(2)
    burst = make_burst(_clean() + SIGMA * rng.standard_normal((4, *SHAPE)))
    assert reconstruct(burst, method="auto").amplitude.noise_gain is None  # its std is the error's
    for method in ("map", "tikhonov", "irwsr", "shift-and-add"):
        estimate = reconstruct(burst, method=method).amplitude
        expected = np.sqrt(np.mean(estimate.std**2)) / estimate.noise_sigma
        assert estimate.noise_gain == pytest.approx(expected)
        assert 0.01 < estimate.noise_gain < 5.0
    stiff = reconstruct(burst, method="tikhonov", prior_weight=1.0).amplitude
    soft = reconstruct(burst, method="tikhonov", prior_weight=1e-3).amplitude
    assert stiff.noise_gain < soft.noise_gain


def test_std_is_computed_once_and_only_when_asked_for() -> None:
    burst = make_burst(_clean() + SIGMA * np.random.default_rng(2).standard_normal((4, *SHAPE)))
    estimate = reconstruct(burst, method="tv").amplitude
    assert callable(estimate.uncertainty)
    assert estimate.std is estimate.std


def test_std_of_a_linear_filter_has_a_closed_form() -> None:
    y = np.zeros((2, 30, 30))
    found = PropagatedStd(
        lambda v: v.mean(axis=0), y, np.ones(y.shape), 0.1, replicates=200, smooth_hr_px=2.0
    )()
    np.testing.assert_allclose(found, 0.1 / np.sqrt(2.0), rtol=0.1)


def test_std_follows_the_weight_of_the_pixels() -> None:
    weight = np.ones((1, 40, 40))
    weight[:, :, 20:] = 0.25
    found = PropagatedStd(
        lambda v: v[0], np.zeros(weight.shape), weight, 0.1, replicates=300, smooth_hr_px=0.0
    )()
    assert found[:, :20].mean() == pytest.approx(0.1, rel=0.03)
    assert found[:, 20:].mean() == pytest.approx(0.2, rel=0.03)


def test_std_of_phasors_is_per_component_and_seeded() -> None:
    y = np.zeros((1, 30, 30), complex)
    found = PropagatedStd(lambda v: v[0], y, np.ones(y.shape), 0.1, 1, replicates=100)()
    assert found.mean() == pytest.approx(0.1, rel=0.05)
    again = PropagatedStd(lambda v: v[0], y, np.ones(y.shape), 0.1, 1, replicates=100)()
    np.testing.assert_array_equal(found, again)


def test_variance_of_two_replicates_is_unbiased() -> None:
    y = np.zeros((1, 60, 60))
    found = PropagatedStd(
        lambda v: v[0], y, np.ones(y.shape), 0.1, replicates=2, smooth_hr_px=0.0
    )()
    assert np.mean(found**2) == pytest.approx(0.1**2, rel=0.1)  # its standard error: 2.4 %


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("drizzle", {}),
        ("drizzle", {"pixfrac": 1.0}),
        ("deconvolution", {}),
        ("deconvolution", {"algorithm": "richardson-lucy"}),
        ("bicubic", {"combine": "median"}),
        ("shift-and-add", {"combine": "median"}),
    ],
)
def test_std_of_plain_methods_is_the_spread_of_their_pictures(
    method: str, options: dict[str, object]
) -> None:
    rng = np.random.default_rng(3)
    frames = _clean() + SIGMA * rng.standard_normal((40, 4, *SHAPE))
    found = [
        reconstruct(
            make_burst(one), method=method, psf_sigma_px=0.3, noise_sigma=SIGMA, **options
        ).amplitude
        for one in frames
    ]
    spread = np.sqrt(np.mean(np.var([one.image for one in found], axis=0, ddof=1)))
    assert np.sqrt(np.mean(found[0].std ** 2)) == pytest.approx(spread, rel=0.15)


@pytest.mark.parametrize("usual_px", [0.02, 3.0])
def test_only_what_a_shift_errs_by_more_than_the_others_is_its_own(usual_px: float) -> None:
    """The reference errs by nothing; where all err alike nobody is to be believed less."""
    sigma_px = usual_px * np.ones((6, 2))
    sigma_px[0] = 0.0
    np.testing.assert_array_equal(_own_error_px(sigma_px, 6), 0.0)
    sigma_px[4] = usual_px * np.array([3.0, 5.0])
    own = _own_error_px(sigma_px, 6)
    assert own[4] == pytest.approx(usual_px * 4.0)  # the mean of 9 and 25, less 1
    assert not np.delete(own, 4).any()
    np.testing.assert_array_equal(_own_error_px(np.zeros((3, 2)), 3), 0.0)
