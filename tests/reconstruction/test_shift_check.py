"""Shifts that are wrong as people get them wrong are named; right ones are left in peace."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from hypothesis import assume, given
from hypothesis import strategies as st
from pixel_camera import SQUARE_PX, Array, edge_scene, make_burst, photograph

from lensshift.camera import camera_preset, named_pattern_px, simulate_tof
from lensshift.core.errors import QualityWarning
from lensshift.core.types import ShiftField, Status
from lensshift.pipeline import demo_burst
from lensshift.reconstruction import glance, shift_check
from lensshift.reconstruction.held_out import Trial
from lensshift.reconstruction.pixel_response import averaged
from lensshift.reconstruction.quick_shifts import without_lone_waves
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.reconstruction.shift_check import CURES, Doubt, _readings
from lensshift.scene import Checker, Plane, Scene, slanted_edge_card

SHAPE = (24, 30)
RNG = np.random.default_rng(2)
SCATTERED_PX = RNG.uniform(-0.7, 0.7, (7, 2))
PAIR_PX = SQUARE_PX[[0, 3]]
SIGMA = 0.016


def doubtful_shifts(frames: Array, offset_px: Array, valid: Array | None = None) -> Doubt | None:
    seen = np.ones(np.shape(frames), bool) if valid is None else valid
    look = glance.glance(frames, offset_px, seen)
    return look and shift_check.doubtful_shifts(look, 2)


def _boxes(row: Array, col: Array) -> Array:
    """Boxes at several angles."""
    found = np.full(np.broadcast(row, col).shape, 0.2)
    for y, x, half, angle, level in (
        (7, 8, 4, 0.3, 0.8), (15, 20, 5, 1.0, 0.5), (18, 7, 3, 0.7, 0.95), (6, 24, 3, 0.1, 0.6),
    ):  # fmt: skip
        across = (row - y) * np.cos(angle) + (col - x) * np.sin(angle)
        along = (col - x) * np.cos(angle) - (row - y) * np.sin(angle)
        found = np.where((np.abs(across) < half) & (np.abs(along) < half), level, found)
    return found


def _weave(row: Array, col: Array) -> Array:
    """Waves in many directions, up to 0.4 cycles per LR pixel."""
    waves = np.random.default_rng(5).uniform(-0.4, 0.4, (20, 2))
    phases = 2 * np.pi * (waves[:, 0, None, None] * row + waves[:, 1, None, None] * col)
    return 0.5 + 0.06 * np.sin(phases + np.arange(20)[:, None, None]).sum(axis=0)


def _upright(row: Array, col: Array) -> Array:
    """An edge along the columns: shifts down it show nowhere."""
    return np.where(col > 14.3, 0.8, 0.2) * np.ones(np.broadcast(row, col).shape)


def _even(row: Array, col: Array) -> Array:
    return np.full(np.broadcast(row, col).shape, 0.5)


def _turned(scene: Callable[..., Array], offset_px: Array, most_deg: float, seed: int) -> Array:
    """Return frames of a camera that turns about its middle, and comes nearer by as much."""
    rng = np.random.default_rng(seed)
    middle = (np.array(SHAPE) - 1) / 2
    seen = []
    for one, turn in zip(offset_px, np.deg2rad(rng.uniform(-most_deg, most_deg, 9)), strict=False):

        def turned(row: Array, col: Array, turn: float = turn) -> Array:
            down, right = row - middle[0], col - middle[1]
            return scene(row - turn * (right + down), col + turn * (down - right))

        seen.append(photograph(turned, SHAPE, one[None])[0])
    return np.array(seen) + SIGMA * rng.standard_normal((len(seen), *SHAPE))


@pytest.mark.parametrize("scene", [_boxes, _weave])
@pytest.mark.parametrize("offset_px", [SQUARE_PX, SCATTERED_PX], ids=["square", "scattered"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_camera_that_turned_is_named(
    scene: Callable[..., Array], offset_px: Array, seed: int
) -> None:
    doubt = doubtful_shifts(_turned(scene, offset_px, 3.0, seed), offset_px)
    assert doubt is not None
    assert doubt.mistake == "frames that turn"
    assert doubtful_shifts(_turned(scene, offset_px, 0.0, seed), offset_px) is None


def _frames(scene: Callable[..., Array], offset_px: Array, sigma: float, seed: int = 0) -> Array:
    y = photograph(scene, SHAPE, offset_px)
    return y + sigma * np.random.default_rng(seed).standard_normal(y.shape)


def test_small_shifts_that_are_told_half_are_doubted() -> None:
    """What frames tell may be off by little, but by little of what they moved."""
    small_px = 0.16 * SCATTERED_PX / np.ptp(SCATTERED_PX, axis=0).max()
    y = _frames(_weave, small_px, 1e-4)
    doubt = doubtful_shifts(y, small_px / 2)
    assert doubt is not None
    assert doubt.mistake == "their unit (too small)"
    assert doubtful_shifts(y, small_px) is None


@pytest.mark.parametrize("times", [0.155, 3.0, 15.0], ids=["mm", "thirds", "um"])
def test_another_unit_is_named_with_the_factor_that_cures_it(times: float) -> None:
    doubt = doubtful_shifts(_frames(_weave, SCATTERED_PX, SIGMA), times * SCATTERED_PX)
    assert doubt is not None
    assert doubt.mistake == "their unit"
    assert doubt.factor == pytest.approx(1 / times, rel=0.1)
    assert f"multiply offset_px by about {doubt.factor:.2g}" in doubt.cure


@pytest.mark.slow
def test_micrometres_on_a_sensor_of_more_than_a_part_are_doubted() -> None:
    """Frames said to lie 39 px apart lie half a pixel apart."""
    y = photograph(_weave, (90, 90), SQUARE_PX)
    y += SIGMA * np.random.default_rng(3).standard_normal(y.shape)
    doubt = doubtful_shifts(y, 77.5 * SQUARE_PX)
    assert doubt is not None
    assert doubt.mistake == "their unit"
    assert doubt.factor == pytest.approx(1 / 77.5, rel=0.2)


def test_frames_that_are_moved_out_of_the_picture_are_named() -> None:
    offset_px = np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 40.0], [0.5, 0.0]])
    burst = make_burst(_frames(_weave, SQUARE_PX, SIGMA), offset_px)
    with (
        pytest.warns(QualityWarning, match="check offset_px"),
        pytest.warns(QualityWarning, match=r"of frame 2 nothing is used.*by 40 px"),
    ):
        reconstruct(burst, std=False, method="tikhonov")


@pytest.mark.parametrize("method", ["tikhonov", "tv", "l1-btv", "map", "irwsr", "irwsr-toolbox"])
def test_every_solver_says_that_shifts_are_wrong(method: str) -> None:
    frames = _frames(_boxes, SQUARE_PX, SIGMA)
    with pytest.warns(QualityWarning, match="rows and columns swapped") as said:
        found = reconstruct(make_burst(frames, SQUARE_PX[:, ::-1]), std=False, method=method)
    assert len(said) == 1
    assert found.amplitude.status is Status.CONTRADICTED
    with warnings.catch_warnings(action="error"):
        reconstruct(make_burst(frames, SQUARE_PX), std=False, method=method)


@pytest.mark.parametrize(("rows", "told"), [(7, False), (8, True)])
def test_lines_of_eight_pixels_are_enough_to_doubt(rows: int, told: bool) -> None:
    y = photograph(_weave, (rows, 60), SQUARE_PX)
    doubt = doubtful_shifts(y + 1e-3 * RNG.standard_normal(y.shape), -SQUARE_PX)
    assert (doubt is not None) is told


@pytest.mark.parametrize(
    ("scene", "offset_px"),  # the default run takes each once
    [
        pytest.param(_boxes, SQUARE_PX, id="boxes-square", marks=pytest.mark.slow),
        pytest.param(_boxes, SCATTERED_PX, id="boxes-scattered"),
        pytest.param(_weave, SQUARE_PX, id="weave-square"),
        pytest.param(_weave, SCATTERED_PX, id="weave-scattered", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    ("wrong", "mistake"),
    [
        (lambda d: -d, "their sign"),
        (lambda d: d * [-1, 1], "sign of the rows"),
        (lambda d: d[:, ::-1], "rows and columns swapped"),
        (lambda d: 2 * d, r"HR pixels.*divide"),
        (lambda d: 0.5 * d, r"too small.*multiply"),
        (lambda d: 0 * d, r"not told.*register"),
        (lambda d: np.roll(d, 1, axis=0), r"order of the frames|swapped, and a sign"),
    ],
    ids=["sign", "sign of rows", "swap", "HR pixels", "too small", "zero", "order"],
)
def test_a_wrong_reading_of_the_shifts_is_named(
    scene: Callable[..., Array], offset_px: Array, wrong: Callable[[Array], Array], mistake: str
) -> None:
    burst = make_burst(_frames(scene, offset_px, SIGMA), wrong(offset_px))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", QualityWarning)
        reconstruct(burst, std=False)
    said = ("contradict offset_px", "does not fit")
    texts = [str(w.message) for w in caught if any(part in str(w.message) for part in said)]
    assert len(texts) == 1
    assert caught[0].filename == __file__
    with pytest.raises(AssertionError, match=mistake):
        raise AssertionError(texts[0])


@pytest.mark.parametrize("scale", [2, 3])
@pytest.mark.parametrize(
    ("mistake", "wrong"),
    [
        ("their sign", lambda d, scale: -d),
        ("the sign of the rows", lambda d, scale: d * [-1, 1]),
        ("the sign of the columns", lambda d, scale: d * [1, -1]),
        ("rows and columns swapped", lambda d, scale: d[:, ::-1]),
        ("rows and columns swapped, and a sign", lambda d, scale: -d[:, ::-1]),
        ("rows and columns swapped, and a sign", lambda d, scale: d[:, ::-1] * [-1, 1]),
        ("rows and columns swapped, and a sign", lambda d, scale: d[:, ::-1] * [1, -1]),
        ("their unit (HR pixels)", lambda d, scale: scale * d),
        ("their unit (too small)", lambda d, scale: d / scale),
        ("the order of the frames", lambda d, scale: d[[2, 0, 1, 4, 3, 6, 5]]),
        ("shifts that were not told", lambda d, scale: 0 * d),
        ("no simple mistake", lambda d, scale: d + np.outer([0, 1, 0, 0, 0, 0, 0], [0.3, -0.2])),
    ],
)
def test_of_each_mistake_there_is_a_reading_without_it(
    mistake: str, wrong: Callable[[Array, int], Array], scale: int
) -> None:
    given = np.array(wrong(SCATTERED_PX, scale))
    readings = _readings(given, SCATTERED_PX, scale)
    assert {name for name, _ in readings} <= set(CURES)
    right = [name for name, d in readings if np.allclose(d, SCATTERED_PX, atol=1e-9)]
    assert mistake in right
    still = [d for name, d in readings if name == "shifts that did not happen"]
    np.testing.assert_array_equal(still, np.zeros((1, 7, 2)))


@pytest.mark.parametrize(
    ("factor", "named"),
    [(4.0, True), (0.2, True), (-4.0, False), (3.0, False), (1 / 3, False), (1.0, False)],
)
def test_another_unit_is_larger_than_none_and_none_that_has_a_name(
    factor: float, named: bool
) -> None:
    names = [name for name, _ in _readings(SCATTERED_PX, factor * SCATTERED_PX, 3)]
    assert ("their unit" in names) is named


@pytest.mark.parametrize("scene", [_boxes, _weave])
@pytest.mark.parametrize("times", [0.5, 2.0])
def test_another_unit_is_named_even_if_the_frames_tell_no_shifts(
    monkeypatch: pytest.MonkeyPatch, scene: Callable[..., Array], times: float
) -> None:
    rng = np.random.default_rng(1)
    for place in (glance, shift_check):
        monkeypatch.setattr(
            place, "found_shifts", lambda _, given: given + rng.uniform(-1.5, 1.5, given.shape)
        )
    doubt = doubtful_shifts(_frames(scene, SQUARE_PX, SIGMA), times * SQUARE_PX)
    assert doubt is not None
    assert doubt.mistake.startswith("their unit")


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("worse", [0.9, 1.0, 1.3])
def test_a_reading_is_as_sure_as_a_paired_t_test_says(
    monkeypatch: pytest.MonkeyPatch, worse: float, seed: int
) -> None:
    """Errors of the same pixels go together; those that only one reading predicts do not count."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.1, 0.3, (2, 4, 9, 14))
    one, two = (size * times + 0.02 * rng.random(size.shape) for times in (worse, 1.0))
    one[:, 0, 2] = two[:, 1, :, 3] = np.nan
    both = np.isfinite(one) & np.isfinite(two)
    seen = np.ones((4, 9, 14))
    trial = Trial(seen, seen > 0, SQUARE_PX, None, seed)
    errors = {SQUARE_PX.tobytes(): one, (-SQUARE_PX).tobytes(): two}

    def told(offset_px: Array, folds: int, *, noise: bool = False) -> Array:
        return 1 + 0 * size if noise else errors[offset_px.tobytes()]

    monkeypatch.setattr(trial, "_errors", told)
    ratio, sure = trial.compare(-SQUARE_PX, 2)
    assert ratio == pytest.approx(one[both].mean() / two[both].mean())
    expected = scipy.stats.ttest_rel(one[both], two[both]).statistic
    assert sure == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("unseen", "said"), [(8, False), (11, True)])
def test_a_reading_of_which_half_of_the_pixels_see_nothing_is_none(
    monkeypatch: pytest.MonkeyPatch, unseen: int, said: bool
) -> None:
    trial = Trial(np.ones((4, 9, 18)), np.ones((4, 9, 18), bool), SQUARE_PX, None)
    worse = np.random.default_rng(0).uniform(0.2, 0.3, (2, 4, 9, 18))

    def told(offset_px: Array, folds: int, *, noise: bool = False) -> Array:
        better = 0.5 * worse
        better[..., : 18 - unseen] = np.nan
        return worse if noise or offset_px is SQUARE_PX else better

    monkeypatch.setattr(trial, "_errors", told)
    ratio, sure = trial.compare(-SQUARE_PX, 2)
    assert ratio == pytest.approx(2.0 if said else 1.0)
    assert (sure > 5.0) is said


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("unseen", ["nothing", "a part", "all but a disc", "the first frame"])
@pytest.mark.parametrize("kind", [1.0, 1.0j])
def test_what_is_not_seen_is_no_edge_that_is_looked_at(
    kind: complex, unseen: str, seed: int
) -> None:
    """A hill of texture on a flat wall of a large level, and the shifts that it tells."""
    rng, shape = np.random.default_rng(seed), (113, 151)
    waves, phases = rng.uniform(-0.25, 0.25, (12, 2)), rng.uniform(0, 2 * np.pi, 12)
    row, col = np.indices(shape, float)
    frames = []
    for down, right in SQUARE_PX:
        r, c = row - down - 30, col - right - 108
        turn = 2 * np.pi * (waves[:, 0, None, None] * r + waves[:, 1, None, None] * c)
        hill = np.exp(-(r**2 + c**2) / (2 * 12**2))
        frames.append(290.0 + 0.3 * hill * np.cos(turn + phases[:, None, None]).sum(axis=0))
    y = np.stack(frames) + 0.02 * rng.standard_normal((4, *shape))
    seen = np.ones(y.shape, bool)
    if unseen == "a part":
        seen[:, 75:105, 20:70] = False
    elif unseen == "all but a disc":
        seen[:] = np.hypot(row - 56, col - 75) < 72
    elif unseen == "the first frame":
        seen[0] = False
    look = glance.glance(kind * y, 0 * SQUARE_PX, seen)
    assert look is not None
    np.testing.assert_array_equal(look.numbers, np.flatnonzero(seen.any(axis=(1, 2))))
    true = SQUARE_PX[look.numbers]
    np.testing.assert_allclose(look.found_px, true - true.mean(axis=0), atol=0.04)
    assert glance.glance(kind * y, 0 * SQUARE_PX, seen & (np.arange(4) == 2)[:, None, None]) is None


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("off", "said"), [(2, None), (4, "no simple mistake")])
def test_a_quarter_of_the_frames_lies_elsewhere_before_all_shifts_are_doubted(
    off: int, said: str | None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    offset_px, turn = rng.uniform(-0.7, 0.7, (9, 2)), rng.uniform(0, 2 * np.pi, off)
    told_px = offset_px.copy()
    told_px[:off] += 0.6 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    doubt = doubtful_shifts(_frames(_weave, offset_px, SIGMA, seed), told_px)
    assert (doubt and doubt.mistake) == said


@pytest.mark.parametrize("scene", [_boxes, _weave, _upright, edge_scene, _even])
@pytest.mark.parametrize(
    "offset_px",
    [SQUARE_PX, SCATTERED_PX, PAIR_PX, 0 * SQUARE_PX, 6 * SQUARE_PX, SQUARE_PX[:1]],
    ids=["square", "scattered", "two", "none", "far", "one frame"],
)
@pytest.mark.parametrize("sigma", [0.0, SIGMA, 0.16])
def test_right_shifts_are_not_doubted(
    scene: Callable[..., Array], offset_px: Array, sigma: float
) -> None:
    assert doubtful_shifts(_frames(scene, offset_px, sigma), offset_px) is None


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("offset_px", [SQUARE_PX, SCATTERED_PX])
def test_noise_alone_doubts_nothing(offset_px: Array, seed: int) -> None:
    y = np.random.default_rng(seed).standard_normal((len(offset_px), *SHAPE))
    assert doubtful_shifts(y, offset_px) is None


def test_a_wall_that_fades_did_move() -> None:
    """Without their means all frames of a slope look as if they lay at one place."""
    row, col = np.meshgrid(np.arange(36.0), np.arange(44.0), indexing="ij")
    for seed in range(6):
        rng = np.random.default_rng(seed)
        shifts = rng.uniform(-0.8, 0.8, (6, 2))
        down, right = shifts.T[:, :, None, None]
        wall = 1 + (row - down) / 200 + (col - right) / 80
        y = wall + 0.002 * rng.standard_normal(wall.shape)
        y *= rng.uniform(0.97, 0.998) ** np.arange(6)[:, None, None]
        assert doubtful_shifts(y, shifts) is None


def test_gain_outliers_and_dead_pixels_are_no_wrong_shifts() -> None:
    y = _frames(edge_scene, SQUARE_PX, SIGMA)
    rng = np.random.default_rng(1)
    gain, bias = 1 + 0.1 * rng.standard_normal(4), 0.03 * rng.standard_normal(4)
    assert doubtful_shifts(gain[:, None, None] * y + bias[:, None, None], SQUARE_PX) is None
    hit = rng.random(y.shape) < 0.03
    assert doubtful_shifts(np.where(hit, rng.integers(0, 2, y.shape), y), SQUARE_PX) is None
    assert doubtful_shifts(np.where(hit, np.nan, y), SQUARE_PX, valid=~hit) is None


@pytest.mark.slow
def test_a_part_of_a_large_sensor_tells_with_shift_fields_and_phasors_too() -> None:
    y = np.zeros((4, 120, 90))
    y[:, 60:84, 40:70] = _frames(_boxes, SQUARE_PX, 0.0)
    y += SIGMA * np.random.default_rng(3).standard_normal(y.shape)
    field = np.broadcast_to(-SQUARE_PX[:, None, None, :], (*y.shape, 2))
    doubt = doubtful_shifts(y * np.exp(0.4j), field)
    assert doubt is not None
    assert doubt.mistake == "their sign"
    burst = make_burst(np.abs(y), -SQUARE_PX, modulation_hz=15e6, distance_m=np.full(y.shape, 3.0))
    with pytest.warns(QualityWarning, match="their sign: negate offset_px"):
        reconstruct(burst, channel="phasor", std=False, shift_field=ShiftField(field))


@pytest.mark.parametrize("seed", [4, pytest.param(6, marks=pytest.mark.slow)])
def test_an_edge_seen_at_thirds_of_a_pixel_is_where_it_is_said_to_be(seed: int) -> None:
    """On a grid of halves its frames are predicted best by shifts of half the size."""
    taken = simulate_tof(
        slanted_edge_card(), camera_preset("o3m151"), named_pattern_px("3x3"), seed=seed
    )
    burst = taken.burst
    assert doubtful_shifts(burst.amplitude, burst.offset_px, valid=burst.valid) is None
    for wrong in (-1, 2):
        assert doubtful_shifts(burst.amplitude, wrong * burst.offset_px, valid=burst.valid)


@pytest.mark.parametrize(("cell_px", "seed"), [(7, 300), (4, 304), (7, 305)])
def test_edges_at_one_place_of_all_pixels_are_where_they_are_said_to_be(
    cell_px: int, seed: int
) -> None:
    """Chequers of whole pixels: a smooth picture predicts half the shifts best, a solver knows."""
    away_m, camera = 6.75, camera_preset("o3m151")
    cell_m = 0.9985 * cell_px * away_m * camera.grid.pitch_mm[0] / camera.optics.focal_length_mm
    tiles, turn_rad = Checker(cell_m, 0.06, 0.6), (0.053, 0.058, 0)
    wall = Plane(centre_m=(0, 0, away_m), turn_rad=turn_rad, reflectance=tiles)
    burst = simulate_tof(Scene((), wall), camera, seed=seed).burst
    for frames in (burst.amplitude, averaged(burst, "phasor")):
        assert doubtful_shifts(frames, burst.offset_px, burst.valid) is None
        for wrong in (-1, 2):
            assert doubtful_shifts(frames, wrong * burst.offset_px, burst.valid)


@pytest.mark.parametrize("wave", [(0.79, -0.03), (0.26, -0.9), (0.11, 0.77)])
@pytest.mark.parametrize("square", [False, True])
def test_a_lone_grating_beyond_the_nyquist_frequency_doubts_nothing(
    wave: tuple[float, float], square: bool
) -> None:
    """It is its alias as well, which moves another way. A box beside it tells wrong shifts."""

    def grating(row: Array, col: Array) -> Array:
        found = 0.5 + 0.3 * np.sin(2 * np.pi * (wave[0] * row + wave[1] * col))
        if square:
            found = np.where(found > 0.5, 0.8, 0.2)
        return found

    def beside(row: Array, col: Array) -> Array:
        return np.where(np.abs(col - 15) < 7, 3 * _boxes(row, col), grating(row, col))

    rng = np.random.default_rng(3)
    noise = 0.004 * rng.standard_normal((4, *SHAPE))
    assert doubtful_shifts(photograph(grating, SHAPE, SQUARE_PX) + noise, SQUARE_PX) is None
    doubt = doubtful_shifts(photograph(beside, SHAPE, SQUARE_PX) + noise, -SQUARE_PX)
    assert doubt is not None
    assert doubt.named


@given(
    st.integers(9, 40), st.integers(9, 40), st.floats(-0.5, 0.5), st.floats(0.0, 0.5),
    st.integers(0, 9),
)  # fmt: skip
def test_a_lone_wave_is_taken_off_whole(
    rows: int, cols: int, down: float, right: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    assume(np.hypot(down * rows, right * cols) > 2.5)
    assume(abs(down) < 0.45 and 0.05 < right < 0.45)
    assume(min((0.5 - abs(down)) * rows, (0.5 - right) * cols) > 1)  # beside its mirror image
    row, col = np.indices((rows, cols))
    phase = rng.uniform(0, 6, 3)[:, None, None]
    y = np.cos(2 * np.pi * (down * row + right * col) + phase)
    seen = rng.random(y.shape) < 0.95
    left = without_lone_waves(y, seen)
    assert left is not None
    assert np.abs(left[seen]).max() < 0.05
    assert without_lone_waves(rng.standard_normal(y.shape), seen) is None


@pytest.mark.parametrize("offset_px", [SQUARE_PX, SCATTERED_PX], ids=["square", "scattered"])
def test_phasors_name_what_an_even_amplitude_hides(offset_px: Array) -> None:
    """Light that comes back alike from all depths: amplitudes fall where two are mixed, no more."""

    def depths(row: Array, col: Array) -> Array:
        return np.exp(0.8j * _boxes(row, col))

    for seed in range(3):
        rng = np.random.default_rng(seed)
        still = photograph(lambda r, c: depths(r, c).real, SHAPE, offset_px)
        y = still + 1j * photograph(lambda r, c: depths(r, c).imag, SHAPE, offset_px)
        y = y + 0.02 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
        assert doubtful_shifts(y, offset_px) is None
        swapped = doubtful_shifts(y, offset_px[:, ::-1])
        assert swapped is not None
        assert swapped.mistake == "rows and columns swapped"
        turned = doubtful_shifts(y * np.exp(2j), offset_px[:, ::-1])
        assert turned is not None
        assert turned.mistake == swapped.mistake


@pytest.mark.parametrize("level", [-0.5, 300.0])
def test_levels_change_no_doubt(level: float) -> None:
    """Zero in the middle of the scene is a level like any other."""
    y = _frames(_boxes, SCATTERED_PX, SIGMA)
    assert doubtful_shifts(y + level, SCATTERED_PX) is None
    doubt = doubtful_shifts(y + level, -SCATTERED_PX)
    assert doubt is not None
    assert doubt.mistake == "their sign"
    assert doubt.ratio == pytest.approx(doubtful_shifts(y, -SCATTERED_PX).ratio, rel=1e-3)


@pytest.mark.parametrize("offset_px", [SQUARE_PX, SCATTERED_PX], ids=["square", "scattered"])
def test_frames_say_where_they_lie_when_unseen_pixels_say_little(offset_px: Array) -> None:
    """Noise is most of each pixel, but all of them together tell their shifts."""
    told = 0
    for seed in range(6):
        y = _frames(_boxes, offset_px, 0.2, seed)
        assert doubtful_shifts(y, offset_px) is None
        doubt = doubtful_shifts(y, offset_px[:, ::-1])
        told += doubt is not None and doubt.mistake == "rows and columns swapped"
    assert told >= 5


@pytest.mark.parametrize("seed", range(3))
def test_a_large_thing_that_moves_is_no_camera_that_turns(seed: int) -> None:
    """Beside one that rests, which a turn would move."""
    rng = np.random.default_rng(seed)
    frames = []
    for number, one in enumerate(SQUARE_PX):

        def scene(row: Array, col: Array, gone: float = 4 / 3 * number) -> Array:
            moves = (np.abs(row - 7.5) < 5) & (np.abs(col - 24 - gone) < 6)
            across = np.abs(row - 7.5 - 0.3 * (col - 44)) < 3.5
            rests = across & (np.abs(col - 44) < 3.5)
            far = np.where(moves, 3.3, np.where(rests, 3.6, 4.0 + 0.02 * (col - 32)))
            return np.where(moves, 0.25, np.where(rests, 0.6, 0.5)) * np.exp(0.628j * far)

        frames.append(
            photograph(lambda r, c: scene(r, c).real, (16, 64), one[None])[0]
            + 1j * photograph(lambda r, c: scene(r, c).imag, (16, 64), one[None])[0]
        )
    y = np.array(frames)
    y = y + 0.02 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    doubt = doubtful_shifts(y, SQUARE_PX)
    assert doubt is None or doubt.mistake != "frames that turn"


def test_parts_without_pixels_say_nothing() -> None:
    y = _frames(_boxes, SCATTERED_PX, SIGMA)
    seen = np.ones(y.shape, bool)
    seen[:, :9, :12] = False
    trial = Trial(y, seen, SCATTERED_PX, None)
    parts = trial.sure_by_part(-SCATTERED_PX, 2, 4)
    assert 0 < len(parts) < 16
    assert np.all(np.isfinite(parts))


@pytest.mark.parametrize("seed", range(3))
def test_wrong_shifts_of_light_below_zero_beside_distances_are_told(seed: int) -> None:
    # Of a camera that takes a dark frame off; the phasor channel refuses such light.
    right = demo_burst(seed=seed)[0]
    distance_m = 2.0 + 0.5 * (right.amplitude > 0.5)
    wrong = replace(
        right, amplitude=right.amplitude - 0.3, distance_m=distance_m, offset_px=-right.offset_px
    )
    with pytest.warns(QualityWarning, match="sign"):
        reconstruct(wrong, channel="amplitude")
