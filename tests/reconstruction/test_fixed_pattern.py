"""What stays at the pixels while the scene moves, and frames without it."""

import warnings

import numpy as np
import pytest
from mosaic import canvas, observe, square
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from lensshift import Burst, Estimate, QualityWarning, reconstruct
from lensshift.core.units import distance_to_phase
from lensshift.reconstruction import told_shifts
from lensshift.reconstruction.fixed_pattern import LAGS, SMOOTH, _kernels, pattern_power
from lensshift.reconstruction.learned.pattern import without_pattern
from lensshift.reconstruction.method import Request

SHAPE, SIGMA = (32, 40), 0.02
Array = NDArray[np.float64]


def hand_held(rng: np.random.Generator, count: int = 9) -> Array:
    return np.asarray(rng.uniform(-1.0, 1.0, (count, 2)))


def seen(seed: int, offset_px: Array) -> tuple[Array, Array]:
    """Return frames of a mosaic in about 0 .. 1 with noise, and the truth."""
    rng = np.random.default_rng(seed)
    one = observe(canvas(rng, SHAPE), SHAPE, offset_px=offset_px, snr=1e6, rng=rng)
    return one.y + SIGMA * rng.standard_normal(one.y.shape), one.truth


def reconstructed(y: Array, offset_px: Array) -> tuple[Estimate, list[str]]:
    burst = Burst.from_arrays(y, offset_px=offset_px, pitch_mm=0.1)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", QualityWarning)
        found = reconstruct(burst, 2, psf_sigma_px=12**-0.5)["amplitude"]
    assert all(one.filename == __file__ for one in said)
    return found, [str(one.message) for one in said]


def pattern(kind: str, rng: np.random.Generator) -> Array:
    shape = {"pixels": SHAPE, "columns": (1, SHAPE[1]), "rows": (SHAPE[0], 1)}[kind]
    found = np.broadcast_to(3 * SIGMA * rng.standard_normal(shape), SHAPE)
    return np.asarray(found - found.mean())


@pytest.mark.parametrize("kind", ["pixels", "columns", "rows"])
def test_covariances_of_a_pattern_are_those_of_its_rough_part(kind: str) -> None:
    # Around and around, where there is no border, the mean over draws is the covariance.
    rng, size, draws = np.random.default_rng(0), 64, 40
    shape = {"pixels": (size, size), "columns": (1, size), "rows": (size, 1)}[kind]
    of_lags = np.zeros(len(LAGS))
    for _ in range(draws):
        y = np.broadcast_to(rng.standard_normal(shape), (size, size))
        r = y - correlate1d(correlate1d(y, SMOOTH, axis=0, mode="wrap"), SMOOTH, 1, mode="wrap")
        of_lags += [np.mean(r * np.roll(r, (-a, -b), (0, 1))) / draws for a, b in LAGS]
    place = ["pixels", "columns", "rows"].index(kind)
    limit = 5 * np.sqrt(2 / (draws * max(shape) * min(shape)))
    np.testing.assert_allclose(of_lags, _kernels()[:, place], atol=limit)


@pytest.mark.parametrize("kind", ["pixels", "columns", "rows"])
def test_a_pattern_is_measured_beside_a_scene(kind: str) -> None:
    found = []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        offset_px = hand_held(rng)
        y, _ = seen(seed, offset_px)
        own = pattern(kind, rng)
        power = pattern_power(y + own, np.ones(y.shape, np.bool_), offset_px)
        assert power is not None
        found.append(np.sqrt(power.variance) / (3 * SIGMA))
    # 32 rows tell their deviation to an eighth.
    np.testing.assert_allclose(np.mean(found), 1.0, atol=0.15)


@pytest.mark.parametrize("told", ["four", "hand-held", "one place"])
def test_frames_without_a_pattern_are_left_as_they_are(told: str) -> None:
    for seed in range(12):
        rng = np.random.default_rng(200 + seed)
        offset_px = {"four": square(2), "hand-held": hand_held(rng), "one place": 0 * square(2)}
        y, _ = seen(seed, offset_px[told])
        power = pattern_power(y, np.ones(y.shape, np.bool_), offset_px[told])
        assert power is None or not power.certain


@pytest.mark.parametrize("value", [0.0, 290.0])
def test_frames_of_one_value_have_no_pattern(value: float) -> None:
    y = np.full((4, *SHAPE), value)
    assert pattern_power(y, np.ones(y.shape, np.bool_), square(2)) is None


def test_shifts_of_another_sign_are_no_pattern() -> None:
    for seed in range(8):
        offset_px = hand_held(np.random.default_rng(300 + seed))
        y, _ = seen(seed, offset_px)
        power = pattern_power(y, np.ones(y.shape, np.bool_), offset_px * [1.0, -1.0])
        assert power is not None
        assert not power.certain


@pytest.mark.parametrize("unit", [1.0, 1e-9, 4000.0])
def test_a_pattern_is_one_in_any_unit_and_at_any_level(unit: float) -> None:
    rng = np.random.default_rng(4)
    offset_px = hand_held(rng)
    y = seen(4, offset_px)[0] + pattern("pixels", rng)
    used = rng.random(y.shape) < 0.999
    plain, other = (
        pattern_power(values, used, offset_px)
        for values in (y, np.where(used, unit * (y + 30.0), np.nan))
    )
    assert plain is not None
    assert other is not None
    np.testing.assert_allclose(other.variance, unit**2 * plain.variance, rtol=1e-3)
    assert plain.certain
    assert other.certain


@pytest.mark.parametrize(("kind", "most"), [("pixels", 0.65), ("columns", 0.8)])
def test_the_picture_is_that_without_the_pattern(
    kind: str, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is smooth over the columns stays: nobody can tell it from the scene.
    share, held = [], []
    for seed in range(3):
        rng = np.random.default_rng(500 + seed)
        offset_px = hand_held(rng)
        y, truth = seen(10 + seed, offset_px)
        assert not any("pattern" in text for text in reconstructed(y, offset_px)[1])
        with_it = y + pattern(kind, rng)
        found, told = reconstructed(with_it, offset_px)
        assert any("pattern of their own" in text for text in told)
        with monkeypatch.context() as patch:
            patch.setattr(told_shifts, "without_pattern", lambda a, b, *_, **__: (a, b, {}))
            left_in, _ = reconstructed(with_it, offset_px)
        errors = [(one.image - truth)[4:-4, 4:-4] for one in (found, left_in)]
        share.append(float(np.std(errors[0]) / np.std(errors[1])))
        held.append(float(np.mean(np.abs(errors[0]) < 2 * np.asarray(found.std)[4:-4, 4:-4])))
    assert np.mean(share) < most
    assert np.mean(held) > 0.85


def test_all_pixels_but_those_cut_off_lose_the_pattern() -> None:
    rng = np.random.default_rng(9)
    offset_px = hand_held(rng)
    y = seen(9, offset_px)[0] + pattern("pixels", rng)
    for cut in (y, np.minimum(y, np.quantile(y, 0.95))):
        burst = Burst.from_arrays(cut, offset_px=offset_px, pitch_mm=0.1)
        with pytest.warns(QualityWarning, match="pattern of their own"):
            found, _, _ = without_pattern(burst, Request(frames=range(9)), 2)
        at_end = (cut == cut.max()) & (np.count_nonzero(cut == cut.max()) > 1)
        np.testing.assert_array_equal(found.amplitude == cut, at_end)
        assert found.amplitude.max() == cut.max() or not at_end.any()


@pytest.mark.parametrize("seed", range(4))
def test_frames_that_did_not_move_are_no_pattern(seed: int) -> None:
    """All of the scene stays at the pixels, not only what is as rough as they are."""
    offset_px = hand_held(np.random.default_rng(seed))
    y, _ = seen(seed, 0.0 * offset_px)
    _, said = reconstructed(y, offset_px)
    assert any("shifts that did not happen" in one for one in said)
    assert not any("pattern" in one for one in said)


def boxes(seed: int, offset_px: Array, hz: float) -> tuple[NDArray[np.complex128], Array]:
    """Return phasors of boxes before a slanted wall with SNR 200, and distances on finer pixels."""
    rng, fine = np.random.default_rng(seed), 8
    rows, cols = ((n + 2) * fine for n in SHAPE)
    row, col = np.mgrid[:rows, :cols]
    distance_m, light = 4.0 + 0.4 * col / cols, np.full((rows, cols), 0.4)
    for _ in range(5):
        at, half = rng.uniform(0, (rows, cols)), rng.uniform(1.0, 7.0, 2) * fine
        inside = (np.abs(row - at[0]) < half[0]) & (np.abs(col - at[1]) < half[1])
        distance_m[inside], light[inside] = rng.uniform(2.0, 3.8), rng.uniform(0.1, 0.8)
    z, frames = light * np.exp(1j * distance_to_phase(distance_m, hz)), []
    for r, c in fine - np.rint(offset_px * fine).astype(int):
        part = z[r : r + SHAPE[0] * fine, c : c + SHAPE[1] * fine]
        frames.append(part.reshape(SHAPE[0], fine, SHAPE[1], fine).mean(axis=(1, 3)))
    y = np.array(frames)
    noise = rng.standard_normal((2, *y.shape)) * np.median(np.abs(y)) / 200
    inner = distance_m[fine:-fine, fine:-fine].reshape(2 * SHAPE[0], 4, 2 * SHAPE[1], 4)
    return y + noise[0] + 1j * noise[1], np.median(inner, axis=(1, 3))


@pytest.mark.parametrize("kind", ["complex", "polar", "frequencies"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_pattern_of_distances_is_told_and_taken_off(kind: str, seed: int) -> None:
    """It was in the picture, without a word."""
    hz = [20e6, 50e6] if kind == "frequencies" else [20e6]
    offset_m = 0.02 * np.random.default_rng(seed).standard_normal(SHAPE)
    told = {"offset_px": square(2), "pitch_mm": 0.1, "modulation_hz": hz}
    errors_m, held = [], []
    for size in (0.0, 1.0):
        each = [boxes(seed, square(2), one) for one in hz]
        turned = np.stack(
            [
                z * np.exp(1j * size * distance_to_phase(offset_m, one))
                for (z, _), one in zip(each, hz, strict=True)
            ]
        )
        if kind == "polar":
            far_m = np.mod(np.angle(turned[0]), 2 * np.pi) / distance_to_phase(1.0, hz[0])
            burst = Burst.from_arrays(np.abs(turned[0]), far_m, **told)
        else:
            burst = Burst.from_arrays(turned if len(hz) > 1 else turned[0], **told)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", QualityWarning)
            result = reconstruct(burst, 2)
        assert ["a pattern of distances of their own" in str(one.message) for one in said] == (
            [True] if size else []
        )
        assert all(one.filename == __file__ for one in said)
        error_m = np.abs(result["distance"].image - each[0][1])
        errors_m.append(np.median(error_m))
        held.append(np.mean(error_m < 2 * np.asarray(result["distance"].std)))
    assert result.settings["distance_pattern_m"] == pytest.approx(0.02, rel=0.2)
    assert errors_m[1] < 0.006
    assert errors_m[0] < errors_m[1]
    assert min(held) > 0.9
