"""Pictures through a lens whose spot varies over the sensor, of scenes known in closed form."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mosaic import SAMPLES, canvas, observe
from scipy.ndimage import gaussian_filter

from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.lens_field import LensField
from lensshift.core.pattern import named_pattern_px
from lensshift.core.types import Burst, ShiftField
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.behind_spots import wider_behind_spots
from lensshift.reconstruction.problem import make_problem, predictor
from lensshift.reconstruction.reconstruct import reconstruct

SHAPE, SCALE, NOISE = (18, 41), 2, 0.003
SQUARE = np.array([[-0.25, -0.25], [-0.25, 0.25], [0.25, 0.25], [0.25, -0.25]])


def curved_field(
    growth_px2: float = 0.16, skew_px3: float = 0.0, lean_px2: float = 0.0
) -> LensField:
    """Return a sharp middle of the sensor and spots of up to 0.4 px at its ends, moved evenly.

    With coma there, opposite on both sides and none in the middle; and leaning one way.
    """
    shift = np.zeros((3, 3, 2, 2, 2))
    shift[0, 0, 1, 0, 0] = shift[0, 0, 0, 1, 1] = 1.0  # a pixel at the end of the reach
    shift[0, 2, 1, 0, 0] = 0.02
    spot = np.zeros((3, 3, 1, 1, 3))
    # 0.005 + growth u^2, and a covariance of lean u^2
    spot[0, 0, 0, 0, :2], spot[0, 2, 0, 0, :2] = 0.005 + 0.5 * growth_px2, 0.5 * growth_px2
    spot[0, 0, 0, 0, 2] = spot[0, 2, 0, 0, 2] = 0.5 * lean_px2
    skew = np.zeros((1, 4, 1, 1, 2))
    skew[0, [1, 3], 0, 0, 1] = 0.75 * skew_px3, 0.25 * skew_px3  # skew u^3
    return LensField(Grid(SHAPE, (0.1, 0.1)), shift, spot, (0.2, 0.2), lens="curved", skew_px3=skew)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_correction_is_of_degree_two_along_each_axis(seed: int) -> None:
    """And adds its share of the shift of the middle to that of each pixel."""
    field, states_mm = curved_field(), np.array([[0.1, -0.15], [0.02, 0.2]])
    row, col = (np.linspace(-1, 1, n)[:, None] ** np.arange(5) for n in SHAPE)
    rng = np.random.default_rng(seed)
    smooth = np.einsum(
        "ri,cj,ijpq->rcpq", row[:, :3], col[:, :3], rng.standard_normal((3, 3, 2, 2))
    )
    before, after = (f.at(states_mm).offset_px for f in (field, field.corrected(0.05 * smooth)))
    middle_px = states_mm @ field.px_per_unit.T
    np.testing.assert_allclose(
        after - before, 0.05 * np.einsum("rcpq,kq->krcp", smooth, middle_px), atol=1e-8
    )
    rough = np.einsum("r,c->rc", row[:, 4], col[:, 3])[..., None, None] * np.eye(2)
    for axis, basis in enumerate((row[:, :3], col[:, :3])):
        fit = basis @ np.linalg.pinv(basis)
        rough = rough - np.moveaxis(np.tensordot(fit, rough, (1, axis)), 0, axis)
    np.testing.assert_allclose(field.corrected(rough).at(states_mm).offset_px, before, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_middle_moves_about_rest_by_the_slopes_of_all_terms(seed: int) -> None:
    """Of T_0 to T_3 the values at rest are 1, 0, -1, 0 and the slopes 0, 1, 0, -3."""
    reach, rest, rise = np.array([0.2, 0.5]), np.array([1, 0, -1, 0]), np.array([0, 1, 0, -3])
    shift = np.random.default_rng(seed).standard_normal((1, 1, 4, 4, 2))
    field = LensField(Grid(SHAPE, (0.1, 0.1)), shift, np.zeros((1, 1, 1, 1, 2)), tuple(reach))
    slopes = [np.einsum("a,b,abp->p", *both, shift[0, 0]) for both in ((rise, rest), (rest, rise))]
    np.testing.assert_allclose(field.px_per_unit, np.stack(slopes, axis=-1) / reach, rtol=1e-5)


@pytest.mark.parametrize(("element", "other", "said"), [(0, 2, 3), (2, 0, 1), (1, None, 0)])
def test_a_burst_of_another_element_is_refused_with_its_number_from_1(
    element: int, other: int | None, said: int
) -> None:
    field = replace(curved_field(), element=element)
    frames, optics = np.ones((4, *SHAPE)), {"lens": "curved", "element": other}
    burst = Burst.from_arrays(frames, offset_px=SQUARE, pitch_mm=0.1, meta={"optics": optics})
    with pytest.raises(DataError, match=f"--element {said}$") as refused:
        field.of(burst)
    assert f"element {element + 1}" in str(refused.value)
    assert field.of(replace(burst, meta={"optics": field.optics})) is not None


@pytest.mark.parametrize(("most_px", "reach"), [(1.31, "1.4"), (2.0, "2"), (3.07, "3.1")])
def test_shifts_beyond_a_field_are_refused_with_the_reach_that_holds_them(
    most_px: float, reach: str
) -> None:
    with pytest.raises(DataError, match=f"frame 1 .*--reach-px {reach}$"):
        curved_field().states([[0.2, -0.9], [0.3, -most_px]])


@pytest.mark.parametrize("name", ["shift_px", "spot_px2"])
@pytest.mark.parametrize(
    "values",
    [np.ones((3, 3, 2, 2)), np.ones((3, 3, 2, 2, 4)), np.ones((3, 0, 2, 2, 2)),
     np.full((1, 2, 1, 3, 2), np.nan)],
    ids=lambda values: str(values.shape),
)  # fmt: skip
def test_coefficients_that_are_none_are_refused(name: str, values: np.ndarray) -> None:
    with pytest.raises(DataError, match="expected") as refused:
        replace(curved_field(), **{name: values})
    assert refused.value.field == name


def waves(seed: int, highest_cpp: float) -> np.ndarray:
    """Return waves [wave 4]: cycles per pixel along row and col, phase, size."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(-highest_cpp, highest_cpp, (24, 2))
    return np.column_stack([along, rng.uniform(0, 2 * np.pi, 24), rng.uniform(0.3, 1.0, 24)])


def seen(
    scene: np.ndarray, row: Any, col: Any, side_px: float, spot_px2: Any, skew_px3: Any
) -> np.ndarray:
    """Return square pixels behind spots [... 2] of known cumulants at places in LR pixels."""
    total = np.full(np.broadcast(row, col).shape, 2.0)
    for f_row, f_col, phase, size in scene:
        passed = np.sinc(side_px * f_row) * np.sinc(side_px * f_col)
        moments = np.array([f_row**2, f_col**2, 2.0 * f_row * f_col])
        passed = passed * np.exp(-2 * np.pi**2 * (spot_px2 @ moments))
        turned = (2 * np.pi) ** 3 / 6 * (skew_px3 @ np.array([f_row, f_col]) ** 3)
        at = 2 * np.pi * (f_row * row + f_col * col) + phase
        total += 0.05 * size * passed * np.cos(at + turned)
    return total


def world(
    seed: int, highest_cpp: float, offset_px: np.ndarray, field: LensField | None = None
) -> tuple[Burst, np.ndarray]:
    field = field or curved_field()
    shown = field.at(field.states(offset_px))
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]]
    scene = waves(seed, highest_cpp)
    frames = np.stack([
        seen(scene, row - shift[..., 0], col - shift[..., 1], 1.0, *spot)
        for shift, *spot in zip(shown.offset_px, shown.spot_px2, shown.skew_px3, strict=True)  # type: ignore[arg-type]
    ])  # fmt: skip
    frames += NOISE * np.random.default_rng(seed + 100).standard_normal(frames.shape)
    hr = [(np.arange(n * SCALE) + 0.5) / SCALE - 0.5 for n in SHAPE]
    sharp = np.zeros((1, 3)), np.zeros((1, 2))
    truth = seen(scene, hr[0][:, None], hr[1][None], 1 / SCALE, *sharp)
    burst = Burst.from_arrays(frames, offset_px=offset_px, pitch_mm=0.1)
    return burst, truth


def rms_at_the_ends(image: np.ndarray, truth: np.ndarray) -> float:
    away = np.abs(np.linspace(-1, 1, truth.shape[1]))
    ends = np.flatnonzero((away > 0.5) & (away < 0.9))
    return float(np.sqrt(np.mean((image - truth)[6:-6][:, ends] ** 2)))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("method", ["auto", "tikhonov", "tv", "l1-btv"])
def test_the_ends_of_a_curved_field_gain_2_db(method: str, seed: int) -> None:
    burst, truth = world(seed, 0.45, SQUARE)
    field = curved_field()
    width_px = (1 / 12 + field.middle_px2) ** 0.5
    one, varying = (
        reconstruct(burst, SCALE, method, psf_sigma_px=width_px, std=False, **known)
        for known in ({"shift_field": _shifts(field, burst)}, {"lens_field": field})
    )
    loss = rms_at_the_ends(one.amplitude.image, truth)  # type: ignore[union-attr]
    left = rms_at_the_ends(varying.amplitude.image, truth)  # type: ignore[union-attr]
    assert 20 * np.log10(loss / left) > 2.0


@pytest.mark.parametrize("method", ["auto", "tikhonov"])
def test_coma_at_the_ends_is_undone(method: str) -> None:
    """Third moments as of a singlet, which turn waves of 0.45 cycles per pixel by half a radian."""
    field = curved_field(skew_px3=0.12)
    burst, truth = world(1, 0.45, SQUARE, field)
    even, whole = (
        rms_at_the_ends(
            reconstruct(burst, SCALE, method, lens_field=one, std=False).amplitude.image, truth
        )  # type: ignore[union-attr]
        for one in (replace(field, skew_px3=None), field)
    )
    assert 20 * np.log10(even / whole) > 3.0


@pytest.mark.parametrize("pattern", ["square", pytest.param("3x3", marks=pytest.mark.slow), "4x4"])
def test_a_sharp_lens_loses_nothing(pattern: str) -> None:
    """Spots of 0.07 to 0.16 px, as those of the published lens: here waves of 0.45 lose most."""
    field = curved_field(0.02)
    burst, truth = world(11, 0.45, named_pattern_px(pattern), field)
    width_px = (1 / 12 + field.middle_px2) ** 0.5
    one, varying = (
        reconstruct(burst, SCALE, psf_sigma_px=width_px, std=False, **known)  # type: ignore[arg-type]
        for known in ({"shift_field": _shifts(field, burst)}, {"lens_field": field})
    )
    for columns in (slice(6, 24), slice(24, 58), slice(58, -6)):
        part = (slice(6, -6), columns)
        loss, left = (
            float(np.std((found.amplitude.image - truth)[part]))  # type: ignore[union-attr]
            for found in (one, varying)
        )
        assert left < 1.03 * loss


@pytest.mark.parametrize("lean_px2", [0.14, -0.14])
@pytest.mark.parametrize("method", ["auto", "tikhonov"])
def test_spots_that_lean_are_undone_along_where_they_lean(method: str, lean_px2: float) -> None:
    """And not as much across it, as a field without their covariance tells it to."""
    field = curved_field(lean_px2=lean_px2)
    upright = replace(field, spot_px2=field.spot_px2[..., :2])
    for seed in (5, 6):
        burst, truth = world(seed, 0.45, SQUARE, field)
        left, loss = (
            rms_at_the_ends(
                reconstruct(burst, SCALE, method, lens_field=one, std=False).amplitude.image,  # type: ignore[union-attr]
                truth,
            )
            for one in (field, upright)
        )
        assert left < 0.75 * loss


def _shifts(field: LensField, burst: Burst) -> Any:
    return replace(field.of(burst), spot_px2=None)


def test_frames_are_predicted_with_their_spots() -> None:
    order = [2, 0, 3, 1]
    burst, _ = world(3, 0.3, SQUARE[order])
    result = reconstruct(burst, SCALE, "tikhonov", lens_field=curved_field(), frames=[0, 1, 2])
    estimate = result.amplitude
    assert estimate is not None
    inner = (slice(3, -3), slice(3, -3))
    for frame in (0, 3, SQUARE[order][3]):
        number = frame if isinstance(frame, int) else 3
        rest = (estimate.predict(frame) - burst.amplitude[number])[inner]
        assert np.sqrt(np.mean(rest**2)) < 4 * NOISE


def test_a_plan_of_any_shape_and_16_places() -> None:
    rng = np.random.default_rng(5)
    for offset_px in (rng.uniform(-0.5, 0.5, (5, 2)), rng.uniform(-0.9, 0.9, (16, 2))):
        burst, truth = world(4, 0.4, offset_px)
        found = reconstruct(burst, SCALE, "auto", lens_field=curved_field(), std=False).amplitude
        assert found is not None
        assert rms_at_the_ends(found.image, truth) < 0.05 * np.std(truth)


def test_shifts_of_two_kinds_are_too_much() -> None:
    burst, _ = world(1, 0.3, SQUARE)
    field = curved_field()
    with pytest.raises(ValueError, match="shift_field or lens_field, got both"):
        reconstruct(burst, lens_field=field, shift_field=field.of(burst))
    with pytest.raises(TypeError, match="expected a LensField, got str; lensshift"):
        reconstruct(burst, lens_field="field.nc")  # type: ignore[arg-type]
    other = Burst.from_arrays(burst.amplitude[:, :-1], offset_px=SQUARE, pitch_mm=0.1)
    with pytest.raises(ValueError, match="make it with --sensor 41x17"):
        reconstruct(other, lens_field=field)


@pytest.mark.parametrize(("skew", "moments"), [(False, 2), (True, 2), (False, 3)])
def test_a_frame_is_predicted_with_its_own_spot_and_an_offset_with_that_of_all(
    skew: bool, moments: int
) -> None:
    rng, shape = np.random.default_rng(4), (6, 9)
    burst = Burst.from_arrays(rng.random((3, *shape)), offset_px=SQUARE[:3], pitch_mm=0.1)
    field_px = np.broadcast_to(SQUARE[:3, None, None], (3, *shape, 2))
    spots = [
        rng.uniform(0.0, 0.1, (*field_px.shape[:3], moments)),
        rng.uniform(-0.1, 0.1, field_px.shape),
    ]
    field = ShiftField(field_px, spot_px2=spots[0], skew_px3=spots[1] if skew else None)
    image = rng.random((12, 18))

    def seen(at_px: np.ndarray, *own: np.ndarray | None) -> np.ndarray:
        model = forward_model(
            shape, SCALE, shift_field_px=np.broadcast_to(at_px, (1, *shape, 2)),
            spot_px2=own[0], skew_px3=own[1],
        )  # fmt: skip
        return np.asarray(model.predict(image)[0])

    problem = make_problem(
        burst, burst.amplitude, SCALE, blur=GaussianBlur(0.3), shift_field=field, noise_sigma=None
    )
    predict = predictor(burst, problem, (0, 1, 2), image, field)
    known = spots if skew else [spots[0], None]
    for k in range(3):
        own = [None if of is None else of[k : k + 1] for of in known]
        np.testing.assert_allclose(predict(k), seen(SQUARE[k], *own), atol=1e-12)
    mean = [None if of is None else of.mean(axis=0)[None] for of in known]
    np.testing.assert_allclose(predict((0.1, 0.2)), seen(np.array([0.1, 0.2]), *mean), atol=1e-12)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("channel", ["amplitude", "phasor"])
def test_pixels_that_coma_and_gaps_hide_have_errors_and_a_misfit(channel: str, seed: int) -> None:
    """Taps of skewed responses fade below 0: beside pixels left out, sums over frames may, too."""
    rng = np.random.default_rng(seed)
    field = curved_field(skew_px3=float(rng.choice([-0.15, 0.15])))
    burst, truth = world(seed, 0.2, SQUARE, field)
    valid = np.ones(burst.amplitude.shape, bool)
    for _ in range(8):
        row, col = rng.integers(0, SHAPE[0]), rng.integers(0, SHAPE[1])
        valid[:, row : row + rng.integers(1, 5), col : col + rng.integers(1, 5)] = False
    known = {"amplitude": burst.amplitude, "valid": valid, "offset_px": SQUARE, "pitch_mm": 0.1}
    known["distance_m"] = np.full(burst.amplitude.shape, 3.0)
    found = reconstruct(
        Burst.from_arrays(**known, modulation_hz=20e6), SCALE, channel=channel, lens_field=field
    ).amplitude
    assert found is not None
    assert found.misfit is not None
    assert np.all(np.isfinite(found.image))
    assert np.all(np.asarray(found.std) > 0)
    assert np.all(found.misfit >= 0)
    hr = np.repeat(np.repeat(valid.all(axis=0), SCALE, 0), SCALE, 1)
    assert np.abs(found.image - truth)[hr].max() < 0.5 * np.ptp(truth)


@pytest.mark.parametrize("channel", ["amplitude", "phasor"])
def test_two_std_hold_errors_behind_wide_spots(channel: str) -> None:
    """Of mosaics whose ends see spots of 0.4 to 0.6 px, where 77 to 80 % were held."""
    field = curved_field(0.35)
    variance_px2 = field.at(np.zeros((1, 2))).spot_px2[0, 0, :, 1]  # type: ignore[index]
    ends = np.repeat(variance_px2 > 0.16, SCALE)
    held = []
    for seed in range(4):
        rng = np.random.default_rng(40 + seed)
        fine = 0.5 + canvas(rng, SHAPE)
        sharp = observe(fine, SHAPE, snr=1e9, rng=rng)
        y = np.empty_like(sharp.y)
        for col, variance in enumerate(variance_px2):
            blurred = gaussian_filter(fine, SAMPLES * variance**0.5, mode="nearest")
            y[..., col] = observe(blurred, SHAPE, snr=1e9, rng=rng).y[..., col]
        y += 0.01 * rng.standard_normal(y.shape)
        known = {"distance_m": np.full(y.shape, 3.0), "modulation_hz": 20e6}
        burst = Burst.from_arrays(y, offset_px=sharp.offset_px, pitch_mm=0.1, **known)
        found = reconstruct(burst, SCALE, channel=channel, lens_field=field)["amplitude"]  # type: ignore[arg-type]
        off = np.abs(found.image - sharp.truth) < 2.0 * np.asarray(found.std)
        held.append(off[4:-4, ends])
    assert np.mean(held) > 0.85


def test_errors_of_one_response_are_no_wider() -> None:
    """And those of spots grow with them, from 1 where there is none."""
    burst, _ = world(1, 0.3, SQUARE)
    plain = make_problem(
        burst, burst.amplitude, SCALE, blur=GaussianBlur(0.3), shift_field=None, noise_sigma=None
    )
    sigma = np.full(burst.amplitude.shape, NOISE / plain.intensity)
    assert np.all(wider_behind_spots(plain, sigma) == 1.0)
    spots = curved_field(0.3).of(burst)
    known = {"blur": GaussianBlur(0.3), "noise_sigma": None}
    varying = make_problem(burst, burst.amplitude, SCALE, shift_field=spots, **known)  # type: ignore[arg-type]
    factor = wider_behind_spots(varying, sigma)
    assert factor.shape == tuple(SCALE * n for n in SHAPE)
    assert np.all(np.diff(factor[0, SHAPE[1] :: SCALE]) >= -1e-12)
    assert 1.0 <= factor.min() < 1.1 < 2.0 < factor.max()
