"""Errors, edges, planes, flying pixels and noise of known scenes come out as put in."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.depth import (
    depth_error,
    edge_location_error,
    fill_rate,
    near_edges,
)
from lensshift.evaluation.noise import temporal_noise
from lensshift.evaluation.surface import fit_plane, flying_pixel_fraction

Floats = NDArray[np.float64]
SHAPE = (17, 33)


def step(column: int = 12, near_m: float = 3.0, far_m: float = 3.5) -> Floats:
    return np.where(np.arange(SHAPE[1]) < column, near_m, far_m) * np.ones((SHAPE[0], 1))


def noise(shape: tuple[int, ...], seed: int = 0) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape)


# Errors against the truth.


def test_errors_of_known_values() -> None:
    truth_m = np.full((1, 4), 2.0)
    error = depth_error([[2.1, 2.0, 1.7, np.nan]], truth_m)
    assert error.rmse_m == pytest.approx(np.sqrt((0.01 + 0.09) / 3))
    assert error.mae_m == pytest.approx(0.4 / 3)
    assert error.bias_m == pytest.approx(-0.2 / 3)
    assert error.median_abs_m == pytest.approx(0.1)
    assert error.p95_abs_m == pytest.approx(0.1 + 0.9 * 0.2)
    assert (error.count, error.fill_rate) == (3, 0.75)
    assert error.edge_count == 0
    assert np.isnan(error.edge_rmse_m)
    assert np.isnan(error.edge_fill_rate)


@pytest.mark.parametrize("scale", [1, 2])
def test_errors_near_the_edge_are_told_apart(scale: int) -> None:
    truth_m = step()
    zone = slice(12 - 2 * scale, 12 + 2 * scale)
    distance_m = truth_m + 0.01
    distance_m[:, zone] += 0.09
    error = depth_error(distance_m, truth_m, scale=scale)
    assert error.edge_rmse_m == pytest.approx(0.1)
    assert error.flat_rmse_m == pytest.approx(0.01)
    assert error.edge_count == 17 * 4 * scale


def test_dropping_edge_pixels_shows_in_the_fill_rate() -> None:
    truth_m, valid = step(), np.ones(SHAPE, dtype=bool)
    distance_m = truth_m.copy()
    distance_m[:, 11:13] = 3.25
    valid[:, 11:13] = False
    honest, dropped = (
        depth_error(distance_m, truth_m),
        depth_error(distance_m, truth_m, valid=valid),
    )
    assert honest.edge_rmse_m == pytest.approx(0.25 / np.sqrt(2))
    assert dropped.edge_rmse_m == 0.0
    assert (honest.edge_fill_rate, dropped.edge_fill_rate) == (1.0, 0.5)
    assert dropped.fill_rate == pytest.approx(31 / 33)


def test_pixels_without_truth_do_not_count() -> None:
    truth_m = step()
    truth_m[3, 4] = np.nan
    known = np.ones(SHAPE, dtype=bool)
    known[5] = False
    distance_m = step() + 0.2
    distance_m[3, 4] = distance_m[5, 5] = 99.0
    error = depth_error(distance_m, truth_m, truth_valid=known)
    assert error.rmse_m == pytest.approx(0.2)
    assert error.count == 17 * 33 - 33 - 1
    assert error.fill_rate == 1.0


def test_what_is_an_edge() -> None:
    assert not near_edges(step(near_m=3.0, far_m=3.14)).any()  # below 5 %
    assert near_edges(step(near_m=3.0, far_m=3.16)).any()
    assert not near_edges(step(near_m=3.0, far_m=3.16), noise_m=0.06).any()
    assert near_edges(step(near_m=3.0, far_m=3.14), min_step_m=0.1).any()
    rows = near_edges(step().T, edge_width_px=1.0)
    assert rows.any(axis=1).nonzero()[0].tolist() == [11, 12]
    # A corner is near by its Euclidean distance.
    truth_m = np.full(SHAPE, 3.0)
    truth_m[:8, :12] = 2.0
    zone = near_edges(truth_m, edge_width_px=2.0)
    assert (zone[8, 12], zone[9, 12], zone[9, 13]) == (True, True, False)


@given(shift_m=st.floats(-2, 2), gain=st.floats(0.1, 10), seed=st.integers(0, 100))
def test_errors_follow_shift_and_unit(shift_m: float, gain: float, seed: int) -> None:
    truth_m, error_m = step(), 0.02 * noise(SHAPE, seed)
    plain = depth_error(truth_m + error_m, truth_m)
    scaled = depth_error(gain * (truth_m + error_m), gain * truth_m)
    assert scaled.edge_rmse_m == pytest.approx(gain * plain.edge_rmse_m, rel=1e-9)
    assert scaled.p95_abs_m == pytest.approx(gain * plain.p95_abs_m, rel=1e-9)
    shifted = depth_error(truth_m + error_m + shift_m, truth_m)
    assert shifted.bias_m == pytest.approx(plain.bias_m + shift_m, abs=1e-9)
    assert shifted.rmse_m**2 == pytest.approx(
        np.mean((error_m + shift_m) ** 2), rel=1e-9, abs=1e-12
    )


@given(seed=st.integers(0, 1000), share=st.floats(0, 0.9))
def test_parts_make_up_the_whole(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    valid = rng.random(SHAPE) >= share
    distance_m = step() + 0.1 * noise(SHAPE, seed)
    error = depth_error(distance_m, step(), valid=valid)
    flat = error.count - error.edge_count
    squares = error.edge_count * error.edge_rmse_m**2 + flat * error.flat_rmse_m**2
    assert squares == pytest.approx(error.count * error.rmse_m**2, rel=1e-9)
    assert fill_rate(distance_m, valid=valid) == pytest.approx(error.fill_rate)


# Place of an edge.


def slanted_step(edge: float, slant: float, scale: int = 1) -> Floats:
    """Return a 3.0 to 3.5 m step averaged over box pixels; edge in LR pixels, at LR row 8."""
    rows, cols = SHAPE[0] * scale, SHAPE[1] * scale
    row_px = (np.arange(rows) + 0.5) / scale - 0.5
    col_px = (np.arange(cols) + 0.5) / scale - 0.5
    place = edge + slant * (row_px[:, None] - 8)
    return 3.0 + 0.5 * np.clip((col_px - place) * scale + 0.5, 0, 1)


@pytest.mark.parametrize("shift_px", [-0.5, 0.0, 0.21, 1.3])
@pytest.mark.parametrize("scale", [1, 2])
def test_shifted_edge(shift_px: float, scale: int) -> None:
    truth_m = slanted_step(15.0, 0.18, scale)
    image_m = slanted_step(15.0 + shift_px, 0.18, scale)
    error = edge_location_error(image_m, truth_m, scale=scale)
    assert error.mean_px == pytest.approx(shift_px, abs=0.04)
    assert error.rms_px == pytest.approx(abs(shift_px), abs=0.04)
    assert error.lines == 17 * scale
    turned = edge_location_error(image_m.T, truth_m.T, scale=scale, along="row")
    assert turned == error


def test_turned_edge_has_rms_but_no_mean() -> None:
    error = edge_location_error(slanted_step(15.0, 0.38), slanted_step(15.0, 0.18))
    rows = np.arange(17) - 8
    assert error.mean_px == pytest.approx(0, abs=0.03)
    assert error.rms_px == pytest.approx(0.2 * np.sqrt(np.mean(rows**2)), abs=0.03)


def test_jagged_edge_has_scatter() -> None:
    truth_m = step(15)
    image_m = truth_m.copy()
    image_m[::2, 15] = 3.0  # every other line one pixel later
    error = edge_location_error(image_m, truth_m)
    assert error.scatter_px == pytest.approx(0.5, abs=0.01)
    assert error.mean_px == pytest.approx(9 / 17, abs=0.01)


def test_lines_without_an_edge_and_gaps() -> None:
    truth_m = slanted_step(15.0, 0.18)
    truth_m[:4] = 3.0
    truth_m[4] = np.nan
    image_m = slanted_step(15.3, 0.18)
    image_m[7, 5] = np.nan
    error = edge_location_error(image_m, truth_m)
    assert error.lines == 12
    assert error.mean_px == pytest.approx(0.3, abs=0.04)
    image_m[7] = np.nan
    with pytest.raises(ValueError, match="4 valid pixels in line 7, got 0"):
        edge_location_error(image_m, truth_m)
    image_m[7] = 3.0
    with pytest.raises(ValueError, match="line 7: expected an edge, got"):
        edge_location_error(image_m, truth_m)


# Planes.


def test_tilted_plane_over_a_pitch() -> None:
    rows, cols = np.mgrid[:17, :33]
    depth_m = 2.0 + 0.3 * 0.01 * rows - 0.2 * 0.02 * cols
    plane = fit_plane(depth_m, pitch_m=(0.01, 0.02))
    expected = np.array([0.3, -0.2, -1.0]) / np.sqrt(0.09 + 0.04 + 1)
    assert plane.normal == pytest.approx(expected, abs=1e-9)
    assert plane.offset_m == pytest.approx(-2.0 / np.sqrt(1.13), rel=1e-9)
    assert plane.max_m < 1e-9
    assert plane.count == 17 * 33


def rays(half_angle_rad: float = 0.4) -> Floats:
    """Return unit vectors (row, col, depth) of a wide camera."""
    tangent = np.tan(half_angle_rad)
    rows, cols = np.meshgrid(
        np.linspace(-tangent / 2, tangent / 2, 17), np.linspace(-tangent, tangent, 33),
        indexing="ij",
    )  # fmt: skip
    vectors = np.stack([rows, cols, np.ones(SHAPE)], axis=2)
    return vectors / np.linalg.norm(vectors, axis=2, keepdims=True)


def test_radial_distances_of_a_wall_make_a_plane() -> None:
    normal = np.array([0.1, 0.3, -1.0]) / np.linalg.norm([0.1, 0.3, -1.0])
    distance_m = -2.5 / (rays() @ normal)  # normal . p = -2.5 m
    plane = fit_plane(distance_m, directions=rays())
    assert plane.normal == pytest.approx(normal, abs=1e-9)
    assert plane.offset_m == pytest.approx(-2.5, abs=1e-9)
    assert plane.rms_m < 1e-9
    # The same distances over a pitch are a bowl, not a plane.
    assert fit_plane(distance_m, pitch_m=0.05).rms_m > 0.02


def test_one_pixel_off_the_plane() -> None:
    depth_m = np.full(SHAPE, 2.0)
    depth_m[8, 16] = 1.9
    plane = fit_plane(depth_m, pitch_m=0.05)
    count = depth_m.size
    assert plane.max_m == pytest.approx(0.1 * (1 - 1 / count), rel=1e-6)
    assert plane.residual_m[8, 16] > 0  # towards the camera
    assert plane.rms_m == pytest.approx(0.1 * np.sqrt(1 / count - 1 / count**2), rel=1e-6)


def test_split_in_bias_and_noise() -> None:
    rows, cols = np.mgrid[:61, :127]
    bowl_m = 0.02 * (((rows - 30) / 30) ** 2 + ((cols - 63) / 63) ** 2)
    bias_m = fit_plane(2.0 + bowl_m, pitch_m=0.05).rms_m
    plane = fit_plane(2.0 + bowl_m + 0.01 * noise((61, 127)), pitch_m=0.05)
    assert plane.noise_rms_m == pytest.approx(0.01, rel=0.02)
    assert plane.bias_rms_m == pytest.approx(bias_m, rel=0.05)
    assert plane.rms_m**2 == pytest.approx(plane.noise_rms_m**2 + plane.bias_rms_m**2)
    flat = fit_plane(2.0 + 0.01 * noise((61, 127)), pitch_m=0.05)
    assert flat.noise_rms_m == pytest.approx(0.01, rel=0.02)
    assert flat.bias_rms_m < 0.002


@given(seed=st.integers(0, 1000))
def test_invalid_pixels_do_not_move_the_plane(seed: int) -> None:
    rows, cols = np.mgrid[:17, :33]
    depth_m = 2.0 + 0.01 * rows + 0.003 * cols
    valid = np.random.default_rng(seed).random(SHAPE) > 0.4
    wrong_m = np.where(valid, depth_m, 77.0)
    plane = fit_plane(wrong_m, valid=valid, pitch_m=0.05)
    assert plane.max_m < 1e-9
    assert np.array_equal(np.isfinite(plane.residual_m), valid)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "either directions or pitch_m"),
        ({"pitch_m": 0.1, "directions": rays()}, "either directions or pitch_m"),
        ({"pitch_m": 0.0}, "positive pitch in m, got 0"),
        ({"directions": rays()[:5]}, r"directions \(17, 33, 3\), got \(5, 33, 3\)"),
        ({"directions": 2 * rays()}, "length 1, got 2 to 2"),
        ({"pitch_m": 0.1, "valid": np.arange(561).reshape(SHAPE) < 33}, "got 33 in one line"),
        ({"pitch_m": 0.1, "valid": np.arange(561).reshape(SHAPE) < 2}, "for a plane, got 2"),
        ({"pitch_m": 0.1, "valid": np.zeros(SHAPE, dtype=bool)}, "for a plane, got 0"),
    ],
)
def test_planes_from_bad_input(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_plane(np.full(SHAPE, 2.0), **settings)  # type: ignore[arg-type]


# Flying pixels.


@pytest.mark.parametrize("with_truth", [True, False])
@pytest.mark.parametrize("noise_m", [0.0, 0.005])
def test_injected_flying_pixels_are_found(with_truth: bool, noise_m: float) -> None:
    truth_m = step()
    distance_m = truth_m + noise_m * noise(SHAPE)
    injected = np.zeros(SHAPE, dtype=bool)
    injected[[2, 5, 6, 11], [11, 12, 11, 12]] = True
    distance_m[injected] = [3.2, 3.3, 3.1, 3.25]
    found = flying_pixel_fraction(distance_m, truth_m if with_truth else None, noise_m=noise_m)
    assert np.array_equal(found.flying, injected)
    assert found.checked[1:, 10:14].all()
    assert found.fraction == pytest.approx(4 / found.checked.sum())


@pytest.mark.parametrize("with_truth", [True, False])
def test_hard_edges_on_tilted_walls_have_no_flying_pixels(with_truth: bool) -> None:
    truth_m = step() + 0.02 * np.arange(33) + 0.01 * np.arange(17)[:, None]
    found = flying_pixel_fraction(truth_m, truth_m if with_truth else None)
    assert found.checked.sum() >= 17 * 4
    assert found.fraction == 0.0


@pytest.mark.parametrize("with_truth", [True, False])
def test_a_pixel_between_the_surfaces_flies_beyond_a_tenth_of_the_step(with_truth: bool) -> None:
    truth_m = step(near_m=3.0, far_m=4.0)
    for mixed_m, flies in ((3.09, False), (3.11, True), (3.89, True), (3.91, False), (4.2, True)):
        distance_m = truth_m.copy()
        distance_m[8, 12] = mixed_m
        found = flying_pixel_fraction(distance_m, truth_m if with_truth else None)
        assert found.flying[8, 12] == flies
        assert found.flying.sum() == flies


def test_nothing_to_check_on_a_plane() -> None:
    # Steps of 6 cm are no edge at 2 m; a wall this steep has no second surface to be off.
    ramp_m = np.ones((9, 1)) * np.linspace(2, 3, 17)
    found = flying_pixel_fraction(ramp_m, ramp_m)
    assert np.isnan(found.fraction)
    assert not found.checked.any()
    assert not flying_pixel_fraction(ramp_m).flying.any()
    lonely_m = np.full(SHAPE, 3.0)
    lonely_m[8, 8] = 2.0  # an outlier, but no edge
    assert not flying_pixel_fraction(lonely_m).checked.any()


def test_invalid_pixels_neither_fly_nor_count() -> None:
    distance_m = step()
    distance_m[:, 12] = 3.25
    valid = np.ones(SHAPE, dtype=bool)
    valid[:, 12] = False
    for truth_m in (step(), None):
        found = flying_pixel_fraction(distance_m, truth_m, valid=valid)
        assert found.fraction == 0.0
        assert not found.checked[:, 12].any()


def test_flying_pixels_of_a_real_box(reference_dir: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(reference_dir / "tof_data" / "ifm_o3d303" / "o3d3xx.h5") as file:
        camera = file["o3d3xx/camera"]
        frames = [camera["depth"][name][()] for name in sorted(camera["depth"])]
        good = [camera["confidence"][name][()] % 2 == 0 for name in sorted(camera["confidence"])]
    distance_m = np.where(good, np.array(frames) / 1000, np.nan)[:, 60:110, 40:80]
    single = flying_pixel_fraction(distance_m[0], noise_m=0.005)
    # Flying pixels are a minority of the pixels near edges, and stay where they are.
    assert single.checked.sum() > 200
    assert 0.1 < single.fraction < 0.4
    again = flying_pixel_fraction(distance_m[1], noise_m=0.005)
    assert np.mean(again.flying[single.flying]) > 0.5


# Noise over time.


@pytest.mark.parametrize("frames", [2, 3, 10, 100])
def test_noise_of_known_sigma(frames: int) -> None:
    measured = temporal_noise(3.0 + 0.012 * noise((frames, 61, 127)))
    assert measured.median == pytest.approx(0.012, rel=0.04)
    freedom = frames - 1
    assert np.sum(freedom * (measured.std / 0.012) ** 2) == pytest.approx(
        freedom * 61 * 127, rel=0.06
    )  # chi squared


def test_pixels_need_two_frames() -> None:
    frames = noise((6, *SHAPE))
    frames[:5, 3, 4] = np.nan
    frames[:4, 5, 6] = np.nan
    valid = np.ones(frames.shape, dtype=bool)
    valid[2:, 7, 8] = False
    measured = temporal_noise(frames, valid=valid)
    assert np.isnan(measured.std).sum() == 1
    assert np.isnan(measured.std[3, 4])
    half_difference = abs(frames[4, 5, 6] - frames[5, 5, 6]) / np.sqrt(2)
    assert measured.std[5, 6] == pytest.approx(half_difference)
    assert measured.std[7, 8] == pytest.approx(np.std(frames[:2, 7, 8], ddof=1))


def test_few_pixels_warn() -> None:
    with pytest.warns(QualityWarning, match="9 pixels in 3 frames tell the noise to 25 %"):
        temporal_noise(noise((3, 3, 3)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        temporal_noise(noise((3, 16, 64)))


@given(gain=st.floats(0.1, 10), seed=st.integers(0, 100))
def test_noise_is_in_the_units_of_the_frames(gain: float, seed: int) -> None:
    lr = step() + 0.01 * noise((8, *SHAPE), seed)
    expected = gain * temporal_noise(lr).median
    assert temporal_noise(gain * lr).median == pytest.approx(expected, rel=1e-9)


def test_noise_of_interpolation() -> None:
    # The mean of two neighbours has 1 / sqrt(2) of the noise of one.
    lr = noise((40, *SHAPE))
    mean = temporal_noise((lr[:, :, 1:] + lr[:, :, :-1]) / 2)
    assert mean.median == pytest.approx(0.5**0.5 * temporal_noise(lr).median, rel=0.03)


# Mistakes of the caller.

GOOD = step()


def test_bad_noise_input() -> None:
    with pytest.raises(ValueError, match=r"\[frame row col\], got shape \(17, 33\)"):
        temporal_noise(GOOD)
    with pytest.raises(ValueError, match="two of 1 frames, got none"):
        temporal_noise(GOOD[None])


@pytest.mark.parametrize(
    ("image", "settings", "message"),
    [
        (GOOD[:5], {}, r"shape \(17, 33\), got \(5, 33\)"),
        (GOOD[0], {}, r"as \[row col\], got shape \(33,\)"),
        (GOOD * 1j, {}, "dtype complex128"),
        (GOOD, {"valid": np.ones(SHAPE)}, "boolean mask .* got float64"),
        (GOOD, {"valid": np.ones((3, 3), dtype=bool)}, r"mask of shape \(17, 33\), got bool of"),
        (GOOD, {"scale": 0}, "scale of at least 1, got 0"),
        (GOOD, {"noise_m": -1.0}, "noise in m of 0 or more, got -1"),
        (GOOD, {"min_step_m": 0.0}, "positive smallest step in m, got 0"),
    ],
)
def test_bad_input(image: Floats, settings: dict[str, object], message: str) -> None:
    for measure in (depth_error, flying_pixel_fraction, edge_location_error):
        with pytest.raises(ValueError, match=message):
            measure(image, GOOD, **settings)  # type: ignore[arg-type]


def test_other_bad_input() -> None:
    with pytest.raises(ValueError, match="valid in the image and in the truth, got none"):
        depth_error(np.full(SHAPE, np.nan), GOOD)
    with pytest.raises(ValueError, match="edge width in px of 0 or more, got nan"):
        near_edges(GOOD, edge_width_px=np.nan)
    with pytest.raises(ValueError, match="along 'row' or 'col', got 'x'"):
        edge_location_error(GOOD, GOOD, along="x")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 2 lines, got 0"):
        edge_location_error(GOOD, np.full(SHAPE, 3.0))


def test_pixels_without_a_distance_and_other_units_are_told() -> None:
    truth = np.full((6, 8), 2.0)
    holed = truth.copy()
    holed[2, 3:5] = 0.0
    with pytest.warns(QualityWarning, match="2 of 48 pixels have a distance of 0 or less"):
        depth_error(holed, truth)
    with pytest.warns(QualityWarning, match="image lies at 2000, the truth at 2"):
        depth_error(np.round(1e3 * truth).astype(np.uint16), truth)
