"""The literal toolbox against the stored outputs of the published code, and its pieces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Status
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.reconstruction.toolbox.irwsr import StepRecord, irwsr_toolbox
from lensshift.reconstruction.toolbox.objective import search_weights, training_pixels
from lensshift.reconstruction.toolbox.prior import WeightedBtv, directions, sparse_transform
from lensshift.reconstruction.toolbox.resize import resize_bicubic, temporal_median
from lensshift.reconstruction.toolbox.scg import minimise_scg
from lensshift.reconstruction.toolbox.system_matrix import stacked_system, system_matrix
from lensshift.reconstruction.toolbox.weights import (
    observation_confidence,
    prior_weights,
    weighted_median,
)

QUARTER_SQUARE = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])

METHODS = {
    "irwsr_cv": {},
    "irwsr_fix": {"prior_weight": 0.01},
    "irwsr_P2": {"prior_weight": 0.005, "window": 2, "alpha": 0.7},
}
RUNS = [
    pytest.param(case, method, marks=[pytest.mark.slow] if slow else [])
    for case, methods, slow in (
        ("edge_x2_4f", METHODS, False),
        ("tofamp_x2_4f", METHODS, False),
        ("tofdepth_x2_4f", METHODS, False),
        ("cam_x2_4f", METHODS, True),
        ("camout_x3_12f", METHODS, True),
    )
    for method in methods
]


@dataclass(frozen=True)
class Case:
    frames: NDArray[np.float64]
    offset_px: NDArray[np.float64]
    scale: int
    psf_sigma_px: float
    seed: int
    expected: dict[str, NDArray[np.float64]]


def load_case(reference_dir: Path, name: str) -> Case:
    with np.load(reference_dir / "irwsr" / f"{name}_input.npz") as given:
        # The toolbox's (tx, ty) says where a pixel looks, ours where the content went.
        frames, offset_px = np.moveaxis(given["LR"], 2, 0), -given["shifts"][:, ::-1]
        scale, psf, seed = int(given["mag"]), float(given["psf"]), int(given["cv_seed"])
    with np.load(reference_dir / "irwsr" / f"{name}_toolbox.npz") as stored:
        return Case(frames, offset_px, scale, psf, seed, dict(stored))


@pytest.mark.parametrize(("name", "method"), RUNS)
def test_equals_the_published_code(reference_dir: Path, name: str, method: str) -> None:
    case = load_case(reference_dir, name)
    images: list[NDArray[np.float64]] = []
    estimate, records = irwsr_toolbox(
        case.frames, case.offset_px, case.scale, case.psf_sigma_px, seed=case.seed,
        on_iteration=lambda _, image: images.append(image), **METHODS[method],
    )  # fmt: skip
    expected = case.expected
    tolerance = 1e-9 if expected[method].dtype == np.float64 else 1e-6
    np.testing.assert_allclose(estimate.image, expected[method], rtol=0, atol=tolerance)
    _check_log(records, expected, method, estimate.status)
    if f"{method}_confidence" in expected:
        confidence = np.moveaxis(expected[f"{method}_confidence"], 2, 0)
        np.testing.assert_allclose(estimate.confidence, confidence, rtol=0, atol=1e-6)
        first = expected[f"{method}_first_iteration"]
        np.testing.assert_allclose(images[0], first, rtol=0, atol=1e-6)


def _check_log(
    records: tuple[StepRecord, ...],
    expected: dict[str, NDArray[np.float64]],
    method: str,
    status: Status,
) -> None:
    # The toolbox returns from a converged step before it writes that step down.
    written = len(records) - (status is Status.CONVERGED)
    for field, stored in (
        ("prior_weight", "lambda"),
        ("noise_sigma", "sigma_noise"),
        ("prior_sigma", "sigma_prior"),
    ):
        values = [getattr(record, field) for record in records[:written]]
        np.testing.assert_allclose(values, expected[f"{method}_{stored}"], rtol=1e-9)


@pytest.mark.parametrize("count", range(1, 8))
def test_frames_of_one_place_start_at_the_median_of_what_is_seen(count: int) -> None:
    rng = np.random.default_rng(count)
    frames = rng.uniform(0.1, 1.0, (count, 7, 10))
    frames[rng.random(frames.shape) < 0.2] = 0.0  # the toolbox takes them for unseen
    frames[:, 2, 3] = 0.0
    found = temporal_median(frames, np.zeros((count, 2)))
    seen = np.ma.masked_array(frames, frames == 0.0)
    np.testing.assert_allclose(found, np.ma.median(seen, axis=0).filled(0.0), rtol=1e-12)


def test_quarter_pixel_square_is_one_small_convolution() -> None:
    rows, cols = 5, 8
    x = np.random.default_rng(1).random((2 * rows, 2 * cols))
    forward, adjoint = stacked_system((rows, cols), 2, QUARTER_SQUARE, 0.3)
    frames = (forward @ x.ravel()).reshape(4, rows, cols)
    # A frame whose content moved up and left sees the lower right quarter of each pixel.
    interlaced = np.empty_like(x)
    interlaced[1::2, 1::2], interlaced[1::2, ::2] = frames[0], frames[1]
    interlaced[::2, 1::2], interlaced[::2, ::2] = frames[2], frames[3]
    side = np.exp(-1.0 / (2 * 0.6**2))
    kernel = np.array([side, 1.0, side])
    np.testing.assert_allclose(kernel / kernel.sum(), [0.1664, 0.6672, 0.1664], atol=5e-5)
    blurred = x
    for axis in (0, 1):
        moved = np.moveaxis(blurred, axis, 0)
        padded = np.pad(moved, ((1, 1), (0, 0)))
        weight = np.pad(np.ones(len(moved)), 1)
        total = kernel[0] * weight[:-2] + kernel[1] * weight[1:-1] + kernel[2] * weight[2:]
        mixed = kernel[0] * padded[:-2] + kernel[1] * padded[1:-1] + kernel[2] * padded[2:]
        blurred = np.moveaxis(mixed / total[:, None], 0, axis)
    np.testing.assert_allclose(interlaced, blurred, atol=1e-12)
    np.testing.assert_array_equal((forward.T - adjoint).toarray(), 0.0)


def test_rows_of_the_system_sum_to_one_and_move_the_content_down_and_right() -> None:
    W = system_matrix((6, 9), 2, np.array([1.25, 2.25]), 0.3)
    total = np.asarray(W.sum(axis=1)).reshape(6, 9)
    np.testing.assert_allclose(total[2:, 3:], 1.0, atol=1e-12)
    np.testing.assert_array_equal(total[0], 0.0)  # no tap of this row is inside the image
    scene = np.zeros((12, 18))
    scene[4, 6] = 1.0  # LR position (1.75, 2.75)
    seen = (W @ scene.ravel()).reshape(6, 9)
    assert np.unravel_index(seen.argmax(), seen.shape) == (3, 5)


def test_half_integer_positions_round_away_from_zero() -> None:
    W = system_matrix((1, 3), 2, np.zeros(2), 0.3).toarray().reshape(3, 2, 6)
    # v = 0.5, 2.5, 4.5: the taps v - 1, v, v + 1 are rounded up, except that -0.5 becomes -1.
    assert [list(np.flatnonzero(row.any(axis=0))) for row in W] == [[1, 2], [2, 3, 4], [4, 5]]


def test_gradient_is_the_derivative_where_the_defects_cannot_show() -> None:
    rng = np.random.default_rng(2)
    x = np.zeros((9, 9))
    x[3:6, 3:6] = rng.random((3, 3))  # flat at the border, uniform weights
    prior = WeightedBtv((9, 9), 1, 0.5, np.ones((8, 9, 9)))
    direction = np.zeros((9, 9))
    direction[3:6, 3:6] = rng.standard_normal((3, 3))
    step = 1e-6 * direction.ravel()
    slope = (prior.value(x.ravel() + step) - prior.value(x.ravel() - step)) / 2e-6
    np.testing.assert_allclose(prior.gradient(x.ravel()) @ direction.ravel(), slope, rtol=1e-6)


def test_objective_reads_the_weights_in_the_wrong_order() -> None:
    weights = np.zeros((8, 2, 3))
    weights[directions(1).index((0, -1))].flat[1] = 1.0  # (0, 1) by rows, (1, 0) by columns
    x = np.array([[0.0, 0.0, 0.0], [5.0, 8.0, 7.0]])
    prior = WeightedBtv((2, 3), 1, 0.5, weights)
    assert prior.value(x.ravel()) == pytest.approx(0.5 * np.sqrt((8.0 - 5.0) ** 2 + 1e-4))
    assert prior.gradient(x.ravel()).nonzero()[0].size == 0  # which reads (0, 1)


def test_the_sparse_transform_is_a_median_with_zeros_outside() -> None:
    image = np.random.default_rng(3).standard_normal((7, 10))
    slope = 0.5 * (np.pad(image, 1, mode="symmetric")[1:-1, :-2] - image)  # of the left neighbour
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(slope, 1), (3, 3))
    found = sparse_transform(image, 1, 0.5)[directions(1).index((0, 1))]
    np.testing.assert_array_equal(found, np.median(windows, axis=(2, 3)))


def test_weighted_median_is_the_first_value_that_holds_half_the_weight() -> None:
    values = np.array([5.0, 1.0, 3.0, 2.0])
    assert weighted_median(values, np.ones(4)) == 2.0
    assert weighted_median(values, np.array([10.0, 1.0, 1.0, 1.0])) == 5.0
    repeated = np.repeat(values, [3, 1, 2, 2])
    assert weighted_median(values, np.array([3.0, 1.0, 2.0, 2.0])) == weighted_median(
        repeated, np.ones(8)
    )
    assert weighted_median(values, np.array([3.0, -1.0, 1.0, 1.0])) == 5.0


def test_confidence_drops_a_biased_frame_and_damps_outliers() -> None:
    rng = np.random.default_rng(4)
    residual = 0.004 * rng.standard_normal((3, 4000))
    residual[1] += 0.15
    residual[2, 0] = 0.5
    confidence, sigma = observation_confidence(residual, np.ones(residual.shape))
    assert sigma == pytest.approx(0.004, rel=0.05)
    np.testing.assert_array_equal(confidence[1], 0.0)
    assert confidence[2, 0] == pytest.approx(2 * sigma / 0.5)
    assert np.mean(confidence[0] == 1.0) == pytest.approx(0.954, abs=0.02)


def test_prior_weights_jump_at_the_threshold() -> None:
    z = np.concatenate((np.linspace(-1, 1, 101), [2.0, 8.0]))
    weights, sigma = prior_weights(z, np.ones(z.size), 0.5)
    assert sigma == pytest.approx(0.52, abs=0.03)
    np.testing.assert_array_equal(weights[:101], 1.0)
    np.testing.assert_allclose(weights[101:], 0.5 * np.sqrt(2 * sigma / z[101:]))


def test_scg_solves_a_quadratic() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((12, 12))
    H, b = root @ root.T + 12 * np.eye(12), rng.standard_normal(12)
    x, f = minimise_scg(
        lambda x: float(0.5 * x @ H @ x - b @ x), lambda x: H @ x - b, np.zeros(12), 60, 1e-12
    )
    np.testing.assert_allclose(x, np.linalg.solve(H, b), atol=1e-6)
    assert f == pytest.approx(-0.5 * b @ np.linalg.solve(H, b))
    flat, _ = minimise_scg(lambda x: 0.0, np.zeros_like, np.ones(3), 5)
    np.testing.assert_array_equal(flat, 1.0)


def test_scg_goes_down_from_a_point_of_negative_curvature() -> None:
    x, f = minimise_scg(
        lambda x: float(np.sum(x**4 - x**2)), lambda x: 4 * x**3 - 2 * x, np.full(2, 0.1), 40
    )
    np.testing.assert_allclose(np.abs(x), np.sqrt(0.5), atol=1e-2)
    assert f == pytest.approx(-0.5, abs=1e-3)


def test_bicubic_resize_keeps_ramps_and_flat_fields() -> None:
    ramp = np.add.outer(2.0 * np.arange(8), 0.5 * np.arange(11))
    up = resize_bicubic(ramp, (24, 33))
    row, col = (np.arange(24) + 0.5) / 3 - 0.5, (np.arange(33) + 0.5) / 3 - 0.5
    expected = np.add.outer(2.0 * row, 0.5 * col)
    np.testing.assert_allclose(up[6:-6, 6:-6], expected[6:-6, 6:-6], atol=1e-12)
    np.testing.assert_allclose(resize_bicubic(np.full((9, 7), 2.0), (4, 5)), 2.0, atol=1e-12)
    stripes = np.tile([0.0, 1.0], (6, 12))
    assert np.ptp(resize_bicubic(stripes, (6, 8))[:, 2:-2]) < 0.1  # antialiased


def test_temporal_median_moves_frames_back_and_ignores_zeros() -> None:
    scene = 1.0 + np.add.outer(0.3 * np.arange(7), 0.1 * np.arange(9))
    frames = np.stack([scene - 0.3 * row - 0.1 * col for row, col in QUARTER_SQUARE])
    median = temporal_median(frames, QUARTER_SQUARE)
    np.testing.assert_allclose(median, scene, atol=1e-12)
    np.testing.assert_array_equal(temporal_median(0 * frames, QUARTER_SQUARE), 0.0)


def test_search_range_shrinks_and_the_split_is_seeded() -> None:
    np.testing.assert_allclose(search_weights(None, 1, 3), [1e-12, 1e-6, 1.0])
    np.testing.assert_allclose(search_weights(0.1, 2, 2), [0.1 / 10**0.5, 0.1 * 10**0.5])
    first, again = (training_pixels(5000, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert 1 - first.mean() == pytest.approx(0.171, abs=0.02)


def small_burst() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(8)
    x = resize_bicubic(0.2 + 0.6 * rng.random((5, 6)), (14, 22))
    forward, _ = stacked_system((7, 11), 2, QUARTER_SQUARE, 0.3)
    y = (forward @ x.ravel()).reshape(4, 7, 11)
    return y + 0.003 * rng.standard_normal(y.shape), QUARTER_SQUARE


def test_confidence_is_used() -> None:
    frames, offset_px = small_burst()
    plain, _ = irwsr_toolbox(frames, offset_px, 2, prior_weight=0.01)
    hole = np.ones(frames.shape)
    hole[2, 3, 4] = 0.0
    frames[2, 3, 4] = 0.0
    found, _ = irwsr_toolbox(frames, offset_px, 2, prior_weight=0.01, confidence=hole)
    assert found.confidence is not None
    assert found.confidence[2, 3, 4] == 0.0
    assert np.abs(found.image - plain.image).max() < 0.05


def test_the_estimate_tells_its_story() -> None:
    frames, offset_px = small_burst()
    steps: list[int] = []
    estimate, _ = irwsr_toolbox(
        frames, offset_px, 2, seed=3, iterations=3, on_iteration=lambda n, image: steps.append(n)
    )
    assert steps == [1, 2, 3]
    assert estimate.status is Status.MAX_ITERATIONS
    assert estimate.image.shape == (14, 22)
    assert len(estimate.objective) == 3
    assert estimate.prior_weight is not None
    assert 1e-12 <= estimate.prior_weight <= 10
    assert estimate.noise_sigma is not None
    assert 0 < estimate.noise_sigma < 0.02


def test_a_frame_that_sees_nothing_changes_nothing() -> None:
    frames, offset_px = small_burst()
    lost = np.concatenate((offset_px, [(1e300, -1e300)]))
    estimate, _ = irwsr_toolbox(np.concatenate((frames, frames[:1])), lost, 2, prior_weight=0.01)
    assert np.isfinite(estimate.image).all()
    assert estimate.confidence is not None
    np.testing.assert_array_equal(estimate.confidence[4], 0.0)


def test_flat_frames_stay_flat() -> None:
    estimate, _ = irwsr_toolbox(np.full((4, 5, 7), 0.4), QUARTER_SQUARE, 2, prior_weight=0.01)
    np.testing.assert_allclose(estimate.image, 0.4, atol=1e-6)
    assert estimate.status is Status.CONVERGED


def test_frames_far_outside_its_range_are_all_rejected_with_a_warning() -> None:
    frames, offset_px = small_burst()
    shifted = frames + np.array([0.0, 300.0, 600.0, 900.0])[:, None, None]
    told = irwsr_toolbox(shifted, offset_px, 2, prior_weight=0.01)[0].notes
    assert "rejects all 4 frames" in told["all_rejected"]
    board = np.indices((9, 13)).sum(axis=0) % 2 + np.array([0.1, -0.1, 0.1, -0.1])[:, None, None]
    board = board + 1e-3 * np.random.default_rng(8).standard_normal(board.shape)  # no copies
    burst = Burst.from_arrays(board, offset_px=offset_px)
    with pytest.warns(QualityWarning, match="rejects all 4 frames") as said:
        reconstruct(burst, method="irwsr-toolbox", prior_weight=0.01)
    assert all(one.filename == __file__ for one in said)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"amplitude": np.ones((4, 5, 6), dtype=complex)}, "real frames"),
        ({"scale": 8, "iterations": 4}, "integer scale from 1 to the 4 iterations"),
        ({"psf_sigma_px": 0.0}, "psf_sigma_px"),
        ({"sparsity": 0.0}, "sparsity"),
        ({"prior_weight": -1.0}, "prior_weight"),
        ({"window": 0}, "window"),
    ],
)
def test_nonsense_is_refused(change: dict[str, object], message: str) -> None:
    settings = {"amplitude": np.random.default_rng(9).random((4, 5, 6))} | change
    burst = Burst.from_arrays(settings.pop("amplitude"), offset_px=QUARTER_SQUARE)
    with pytest.raises(ValueError, match=message):
        reconstruct(burst, method="irwsr-toolbox", channel="amplitude", **settings)
