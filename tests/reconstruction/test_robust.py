"""Maximum a posteriori fits by reweighting, and Farsiu's on outliers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lensshift.core.types import Status
from lensshift.evaluation import psnr_db
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.losses import LOSSES
from lensshift.reconstruction.priors import BilateralTotalVariation
from lensshift.reconstruction.solver import Reweighted

SQUARE_PX = [(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)]


@pytest.mark.parametrize("data_term", ["l2", "l1", "huber"])
def test_finds_a_simple_scene(data_term: str) -> None:
    model = forward_model((12, 14), 2, SQUARE_PX)
    truth = np.where(np.arange(28) > 13, 0.8, 0.2) * np.ones((24, 1))
    y = model.predict(truth) + np.random.default_rng(0).normal(0, 0.003, (4, 12, 14))
    steps: list[int] = []
    weight = np.ones(y.shape)
    fit = Reweighted(LOSSES[data_term](), BilateralTotalVariation(1, 0.5), 0.01)
    found = fit(model.operator, y, weight, on_iteration=lambda t, _: steps.append(t))
    assert psnr_db(found.image, truth) > 32
    assert steps == list(range(1, len(found.objective) + 1))
    assert found.confidence is not None
    assert found.confidence.shape == y.shape
    assert found.status in (Status.CONVERGED, Status.MAX_ITERATIONS)


def test_l1_and_bilateral_prior_withstand_outliers(reference_dir: Path) -> None:
    with np.load(reference_dir / "irwsr" / "camout_x3_12f_input.npz") as given:
        y, truth = np.ascontiguousarray(np.moveaxis(given["LR"], 2, 0)), given["gt"]
        model = forward_model(
            y.shape[1:], 3, -given["shifts"][:, ::-1], blur=GaussianBlur(float(given["psf"]))
        )
    found = Reweighted(LOSSES["l1"](), BilateralTotalVariation(2, 0.7), 0.01)(
        model.operator, y, np.ones(y.shape)
    )
    assert psnr_db(found.image, truth) > 28.0  # the published toolbox's L1 + BTV: 28.01


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", LOSSES)
def test_losses_are_touched_from_above(name: str, seed: int) -> None:
    """rho(s) <= rho(r) + w (s^2 - r^2), the weight w being that of the quadratic at r."""
    loss, rng = LOSSES[name](), np.random.default_rng(seed)
    r, s = 0.1 * rng.standard_t(2, (2, 3, 7, 9))
    weight = rng.random(r.shape)
    belief = loss.believe(r, weight, weight)
    for one in np.eye(r.size).reshape(-1, *r.shape):  # in each pixel: the sum would hide a jump
        above = loss.cost(r, one * weight, belief) + np.sum(one * belief.weight * (s**2 - r**2))
        assert loss.cost(s, one * weight, belief) <= above + 1e-12


@pytest.mark.parametrize("name", LOSSES)
def test_weights_are_the_slope_of_the_loss(name: str) -> None:
    """d rho / d r = 2 w r, by differences of the cost of single pixels."""
    loss, rng, step = LOSSES[name](), np.random.default_rng(3), 1e-6
    r = 0.1 * rng.standard_t(2, (2, 5, 7))
    weight = rng.random(r.shape)
    belief = loss.believe(r, weight, weight)
    slope = [
        loss.cost(r + one, weight, belief) - loss.cost(r - one, weight, belief)
        for one in step * np.eye(r.size).reshape(-1, *r.shape)
    ]
    found = np.reshape(slope, r.shape) / (2 * step)
    np.testing.assert_allclose(found, 2 * belief.weight * r, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("name", LOSSES)
def test_a_pixel_that_fits_is_believed_as_far_as_it_counts_and_none_more_than_wholly(
    name: str,
) -> None:
    weight = np.random.default_rng(3).choice([0.0, 0.4, 1.0, 3.0], (2, 5, 7))
    residual = 0.1 * np.random.default_rng(4).standard_t(2, weight.shape)
    residual[0] = 0.0
    confidence = LOSSES[name]().believe(residual, weight, weight).confidence
    np.testing.assert_allclose(confidence[0], np.minimum(weight[0], 1.0))
    assert np.all(confidence[1] <= np.minimum(weight[1], 1.0))
