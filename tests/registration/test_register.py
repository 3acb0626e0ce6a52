"""Shifts found from the frames: accuracy, honesty, bad input."""

import warnings
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scenes import PITCH_MM, SNR_50, checker, random_boxes, scene, taken, waves

from lensshift.camera import QUARTER_SQUARE_PX, RunningCamera, camera_preset
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst
from lensshift.registration import blocks, likely_shifts, phase_correlation, register
from lensshift.registration.blocks import blocks_of, likely_where_telling, scatter_over_blocks
from lensshift.registration.light import gains_of_light
from lensshift.registration.likelihood import ShiftFit, likely_steps, with_given
from lensshift.registration.register import _warn_if_poor
from lensshift.scene import four_boxes, siemens_star_card

OFFSETS = np.array([[0.0, 0.0], [0.31, -0.42], [-1.27, 0.66], [2.4, 3.1], [-0.2, 0.9]])


def burst_of(frames: np.ndarray, offset_px: np.ndarray | None = None, **fields: object) -> Burst:
    given = np.zeros((len(frames), 2)) if offset_px is None else offset_px
    return Burst.from_arrays(frames, offset_px=given, pitch_mm=PITCH_MM, **fields)


@pytest.mark.parametrize(
    ("method", "within_px"), [("auto", 1e-3), ("gradient", 5e-3), ("phase", 0.06)]
)
def test_waves_without_noise_are_found_from_nothing(method: str, within_px: float) -> None:
    found = register(burst_of(waves(OFFSETS)), method=method)
    np.testing.assert_allclose(found.offset_px, OFFSETS, atol=within_px)
    assert found.offset_source == "registered"


def test_the_offset_of_the_reference_is_kept() -> None:
    given = OFFSETS + np.array([0.5, -0.25])
    found = register(burst_of(waves(OFFSETS), given), reference=2)
    np.testing.assert_allclose(found.offset_px, given, atol=1e-3)
    np.testing.assert_array_equal(found.offset_px[2], given[2])
    assert np.all(found.offset_sigma_px[2] == 0.0)
    assert np.all(found.offset_sigma_px[[0, 1, 3, 4]] > 0.0)


def test_phase_correlation_has_the_sign_of_offsets() -> None:
    frames = waves(np.array([[0.0, 0.0], [2.0, -5.0]]), (24, 41))
    np.testing.assert_allclose(phase_correlation(*frames), [2.0, -5.0], atol=0.06)


def test_shifts_of_nine_frames_err_by_what_is_told() -> None:
    """At SNR 200 edges, which are no random field, err by more than the likelihood believes."""
    planned_px = tuple(product((-1 / 3, 0.0, 1 / 3), repeat=2))
    bright = replace(SNR_50, full_well_electrons=80_000.0, bits=16)
    over = []
    for seed in range(6):
        burst, true_px = taken(random_boxes(seed), 0.06, seed, planned_px, bright)
        found = register(burst)
        assert found.offset_sigma_px is not None
        over.append((found.offset_px - true_px)[1:] / found.offset_sigma_px[1:])
    assert 0.6 < np.sqrt(np.mean(np.square(over))) < 1.25


@pytest.mark.parametrize("side", [2, 3])
def test_a_fixed_pattern_does_not_hold_the_shifts_back(side: int) -> None:
    """Pixels whose gain differs by 3 % show that in all frames, as a scene that stood still."""
    bright = replace(SNR_50, full_well_electrons=80_000.0, bits=16)
    planned_px = tuple(product((np.arange(side) - (side - 1) / 2) / side, repeat=2))
    away_px, over = [], []
    for seed in range(3):
        burst, true_px = taken(random_boxes(seed), 0.06, seed, planned_px, bright)
        gain = 1.0 + 0.03 * np.random.default_rng(seed).standard_normal(burst.grid.shape)
        found = register(replace(burst, amplitude=burst.amplitude * gain))
        away_px.append((found.offset_px - true_px)[1:])
        over.append(away_px[-1] / found.offset_sigma_px[1:])
    assert np.sqrt(np.mean(np.square(away_px))) < 0.005
    assert np.sqrt(np.mean(np.square(over))) < 1.3


def test_pixels_that_no_frame_sees_do_not_hold_the_shifts_back() -> None:
    """They lie at one place in all frames, as if there a scene stood still."""
    planned_px = tuple(product((-1 / 3, 0.0, 1 / 3), repeat=2))
    whole, without = [], []
    for seed in range(3):
        burst, true_px = taken(random_boxes(seed), 0.06, seed, planned_px)
        seen = np.random.default_rng(seed).random(burst.grid.shape) > 0.05
        whole.append(register(burst).offset_px - true_px)
        masked = replace(burst, valid=np.broadcast_to(seen, burst.amplitude.shape))
        without.append(register(masked).offset_px - true_px)
    assert np.sqrt(np.mean(np.square(without))) < 1.5 * np.sqrt(np.mean(np.square(whole)))


@cache
def error_and_sigma_px(name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    burst, true_px = taken(scene(name), seed=seed)
    found = register(burst)
    assert found.offset_sigma_px is not None
    return found.offset_px - true_px, found.offset_sigma_px


@pytest.mark.parametrize("name", ["demo", "four boxes", "checker", "random"])
def test_aliased_noisy_frames_to_a_fiftieth_of_a_pixel(name: str) -> None:
    error = [error_and_sigma_px(name, seed)[0] for seed in (0, 1)]
    assert np.sqrt(np.mean(np.square(error))) < 0.02


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
@pytest.mark.parametrize("method", ["auto", "gradient", "phase"])
def test_the_unit_of_the_frames_means_nothing(method: str) -> None:
    frames = taken(scene("demo"), seed=4)[0].amplitude
    one, *others = (register(burst_of(u * frames), method=method) for u in (1.0, 1e-24, 1e-9, 1e24))
    for other in others:
        np.testing.assert_allclose(other.offset_px, one.offset_px, atol=1e-6)
        np.testing.assert_allclose(other.offset_sigma_px, one.offset_sigma_px, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_two_frames_know_that_something_moved(seed: int) -> None:
    burst, true_px = taken(scene("random"), seed=seed)
    frames = burst.amplitude[:2].copy()
    for number, frame in enumerate(frames):
        frame[2:14, 4 + 3 * number : 18 + 3 * number] = 0.9
    with pytest.warns(QualityWarning, match="does something move"):
        found = register(burst_of(frames))
    error_px = found.offset_px[1] - (true_px[1] - true_px[0])
    assert np.abs(error_px).max() > 0.2
    assert np.all(np.abs(error_px) < 3.0 * found.offset_sigma_px[1])


def test_parts_say_what_the_whole_errs_by() -> None:
    """The variance of a weighted mean, whatever errors its four parts believe to have."""
    rng = np.random.default_rng(5)
    believed = np.array([0.01, 0.01, 0.02, 0.04])
    weight = believed**-2 / np.sum(believed**-2)
    frames, known, told = np.zeros((2, 16, 64)), np.ones((2, 16, 64), np.bool_), []
    assert len(blocks_of(frames.shape[1:])) == len(believed)
    for _ in range(400):
        true = 0.3 * rng.normal(size=(4, 2))
        parts = iter([np.array([[0.0, 0.0], shift]) for shift in true])
        errors = iter([np.array([[0.0, 0.0], [one, one]]) for one in believed])
        found = scatter_over_blocks(
            lambda *_, parts=parts, errors=errors: (next(parts), next(errors)),
            frames, known, np.array([[0.0, 0.0], weight @ true]),
        )  # fmt: skip
        assert not np.any(found.covariance_px2[:2])  # the reference
        told.append(np.diag(found.covariance_px2)[2:])
        # A whole that knows less than its parts believe does not know still less for it.
        weak = np.diag([0.0, 0.0, 0.1**2, 0.1**2])
        assert np.all(np.diag(found.widened(weak) - weak - found.covariance_px2) <= 0.0)
    # Of normal parts: sum of weight^2 (d - mean)^2, of variance s^2 (1 - 2 w + sum of w^2).
    expected = 4 / 3 * 0.3**2 * np.sum(weight**2 * (1 - 2 * weight + np.sum(weight**2)))
    np.testing.assert_allclose(np.mean(told), expected, rtol=0.1)


@pytest.mark.parametrize("photometric", [False, True])
def test_parts_step_to_where_a_search_of_each_ends(photometric: bool) -> None:
    offset_px = np.array([[0.0, 0.0], [0.3, -0.2], [-0.4, 0.1], [0.2, 0.45]])
    frames = waves(offset_px, (40, 52))
    frames += 0.1 * np.std(frames) * np.random.default_rng(7).standard_normal(frames.shape)
    valid = np.random.default_rng(8).random(frames.shape) > 0.02
    told = {"reference": 1, "photometric": photometric}
    whole = likely_shifts(frames, valid, offset_px, **told)
    parts = [(rows, cols) for rows in (np.s_[:20], np.s_[20:]) for cols in (np.s_[:26], np.s_[26:])]
    steps = likely_steps(frames, valid, whole, parts, **told)
    for part, (step_px, sigma_px) in zip(parts, steps, strict=True):
        alone = likely_shifts(frames[:, *part], valid[:, *part], whole.offset_px, **told)
        moved_px = alone.offset_px - whole.offset_px
        assert np.all(np.abs(step_px - moved_px) <= 0.3 * alone.sigma_px)
        np.testing.assert_allclose(sigma_px, alone.sigma_px, rtol=0.25)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_parts_that_show_little_do_not_spoil_the_errors_of_the_whole(seed: int) -> None:
    """Two of the four quarters of these boxes disagree by 0.1 px, and more, of their own."""
    camera = camera_preset("o3m151")
    true_px = np.array(QUARTER_SQUARE_PX)
    rng, running = np.random.default_rng(seed), RunningCamera(four_boxes(), camera)
    frames = np.array([running.frame(one[None], rng).amplitude for one in true_px])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        found = register(burst_of(frames))
    error_px = (found.offset_px - true_px) - (found.offset_px - true_px)[0]
    told_px = found.offset_sigma_px
    assert np.all(np.abs(error_px) <= 3.0 * told_px)
    assert np.sqrt(np.mean(told_px**2)) < 4.0 * np.sqrt(np.mean(error_px**2))


def test_planned_offsets_decide_between_repeats_of_a_pattern() -> None:
    burst, true_px = taken(checker)
    np.testing.assert_allclose(register(burst, method="gradient").offset_px, true_px, atol=0.05)


def test_standard_errors_are_as_large_as_errors() -> None:
    bursts = product(("four boxes", "random", "demo"), (0, 1))
    error, told = np.array([error_and_sigma_px(*one) for one in bursts])[:, :, 1:].swapaxes(0, 1)
    ratio = np.sqrt(np.mean(np.square(error)) / np.mean(np.square(told)))
    assert 0.5 < ratio < 1.5  # 36 errors, six of each burst


def edge(angle_deg: float, seed: int, shape: tuple[int, int] = (17, 40)) -> Burst:
    """Return frames of one edge, blurred by square pixels, under noise; offsets known."""
    rng = np.random.default_rng(seed)
    offset_px = rng.uniform(-0.6, 0.6, (4, 2))
    offset_px -= offset_px[0]
    fine = (np.arange(8) + 0.5) / 8 - 0.5
    row = (np.arange(shape[0])[:, None] + fine).ravel() - (shape[0] - 1) / 2
    col = (np.arange(shape[1])[:, None] + fine).ravel() - (shape[1] - 1) / 2
    normal = np.deg2rad(angle_deg)
    frames = []
    for down, right in offset_px:
        across = (row[:, None] - down) * np.sin(normal) + (col - right) * np.cos(normal)
        whole = 0.2 + 0.6 * (across > 0)
        frames.append(whole.reshape(shape[0], 8, shape[1], 8).mean(axis=(1, 3)))
    noise = rng.normal(scale=0.01, size=(4, *shape))
    return Burst.from_arrays(np.array(frames) + noise, offset_px=offset_px, pitch_mm=PITCH_MM)


@pytest.mark.parametrize("angle_deg", [4.0, -9.0, 82.0])
def test_along_an_edge_nothing_is_known(angle_deg: float) -> None:
    """The aperture problem: across the edge the shift is found, along it standard errors say so."""
    normal = np.deg2rad(angle_deg)
    across, along = np.array([[np.sin(normal), np.cos(normal)], [np.cos(normal), -np.sin(normal)]])
    for seed in range(3):
        burst = edge(angle_deg, seed)
        with pytest.warns(QualityWarning, match="too little texture"):
            found = register(replace(burst, offset_px=np.zeros((4, 2))))
        wrong = found.offset_px - burst.offset_px
        assert np.abs(wrong @ across).max() < 0.05
        assert np.all(found.offset_sigma_px[1:] @ np.abs(along) > 1.0)
        assert np.all(np.abs(wrong) < 2 * found.offset_sigma_px + 1e-9)


def siemens_star(shape: tuple[int, int], cycles: int, seed: int) -> Burst:
    """Black and white sectors on a grey card, 11 x 11 points in a pixel, SNR 50."""
    rng = np.random.default_rng(seed)
    corners = 0.25 * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    offset_px = corners + 0.05 * rng.standard_normal((4, 2))
    row, col = ((np.arange(11 * size) + 0.5) / 11 - size / 2 for size in shape)
    frames = []
    for down, right in offset_px:
        y, x = row[:, None] - down, col - right
        sectors = 0.5 + 0.35 * np.sign(np.sin(cycles * np.arctan2(y, x)))
        whole = np.where(np.hypot(y, x) < 0.45 * min(shape), sectors, 0.5)
        frames.append(whole.reshape(shape[0], 11, shape[1], 11).mean(axis=(1, 3)))
    noise = rng.normal(scale=0.014, size=(4, *shape))
    return Burst.from_arrays(np.array(frames) + noise, offset_px=offset_px, pitch_mm=PITCH_MM)


@pytest.mark.parametrize(("shape", "cycles"), [((37, 53), 24), ((29, 31), 12), ((45, 38), 20)])
def test_a_star_has_nothing_at_low_frequencies_and_is_found(
    shape: tuple[int, int], cycles: int
) -> None:
    for seed in (1, 2):
        burst = siemens_star(shape, cycles, seed)
        found = register(Burst.from_arrays(burst.amplitude, pitch_mm=PITCH_MM))
        wrong = (found.offset_px - burst.offset_px) - (found.offset_px - burst.offset_px)[0]
        assert np.abs(wrong).max() < 0.05


@pytest.mark.parametrize("seed", [0, 3])
def test_spokes_are_not_taken_for_shifts_by_many(seed: int) -> None:
    """Sixteen rows of a star: low frequencies said 3.3 px, where the frames are less alike."""
    rng = np.random.default_rng(seed)
    running = RunningCamera(siemens_star_card(), camera_preset("o3m151"))
    true_px = np.array(QUARTER_SQUARE_PX) + rng.normal(0.0, 0.02, (4, 2))
    frames = np.array([running.frame(one[None], rng).amplitude for one in true_px])
    found_px = np.array([phase_correlation(frames[0], one) for one in frames])
    assert np.abs(found_px - (true_px - true_px[0])).max() < 0.5


@pytest.mark.parametrize("seed", [1, 11, 19, 31])
def test_of_stars_that_frames_share_in_part_the_shift_is_found(seed: int) -> None:
    """A quarter of the rows leaves the frame; the highest peak lay up to 13 px elsewhere."""
    rng, shift_px = np.random.default_rng(seed), np.array([-3.8, -4.5])
    place_px, light = rng.uniform((-8, -8), (24, 72), (160, 2))[:60], rng.exponential(1.0, 60)
    row, col = np.arange(16.0)[:, None], np.arange(64.0)
    frames = [
        sum(
            size * np.exp(-((row - r) ** 2 + (col - c) ** 2) / 0.72)
            for (r, c), size in zip(place_px + moved_px, light, strict=True)
        )
        + 0.02 * rng.standard_normal((16, 64))
        for moved_px in (np.zeros(2), shift_px)
    ]
    np.testing.assert_allclose(phase_correlation(*frames), shift_px, atol=0.3)


def test_texture_is_not_taken_for_a_pattern_that_repeats() -> None:
    """A peak at half the height of the correlation is none where the frames are not alike."""
    rng = np.random.default_rng(4)
    waves_cpp, phase = rng.uniform(-0.6, 0.6, (160, 2)), rng.uniform(0, 2 * np.pi, 160)
    size = (0.05 + np.hypot(*waves_cpp.T)) ** -1.2
    row, col = np.arange(49.0)[:, None, None], np.arange(71.0)[:, None]
    for seed in (0, 1):
        offset_px = np.cumsum(np.random.default_rng(seed).uniform(-1.2, 1.2, (5, 2)), axis=0)
        frames = np.array([
            (size * np.cos(2 * np.pi * ((row - down) * waves_cpp[:, 0]
                                        + (col - right) * waves_cpp[:, 1]) + phase)).sum(-1)
            for down, right in offset_px
        ])  # fmt: skip
        frames += rng.normal(scale=frames.std() / 6, size=frames.shape)
        found = register(Burst.from_arrays(frames, pitch_mm=PITCH_MM))
        wrong = (found.offset_px - offset_px) - (found.offset_px - offset_px)[0]
        assert found.offset_sigma_px.max() < 0.05
        assert np.abs(wrong).max() < 0.1


def test_planned_offsets_stay_where_the_frames_tell_nothing() -> None:
    burst = edge(3.0, 5)
    planned = burst.offset_px + np.array([[0.0, 0.0], [0.04, 0.05], [-0.05, 0.06], [0.06, -0.04]])
    with pytest.warns(QualityWarning, match="along row"):
        found = register(replace(burst, offset_px=planned))
    # What the frames ask for is along the normal of the edge, 3 degrees off the rows.
    moved = found.offset_px - planned
    np.testing.assert_allclose(moved[:, 0], np.tan(np.deg2rad(3.0)) * moved[:, 1], atol=1e-3)
    np.testing.assert_allclose(found.offset_px[:, 1], burst.offset_px[:, 1], atol=0.05)


def test_a_pattern_that_repeats_is_named_unless_it_is_known_by_how_much() -> None:
    burst, true_px = taken(checker)
    with pytest.warns(QualityWarning, match="repeats or shows little"):
        found = register(replace(burst, offset_px=np.zeros_like(true_px)))
    wrong = found.offset_px - (true_px - true_px[0])
    assert np.all(np.hypot(*wrong.T) <= 2 * np.hypot(*found.offset_sigma_px.T) + 1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register(burst)


@pytest.mark.slow
def test_fisher_information_agrees_with_monte_carlo() -> None:
    """Random fields as the model assumes them: errors of many draws against one promise."""
    rng = np.random.default_rng(3)
    true_px = np.array([[0.0, 0.0], [0.4, 0.3], [-0.35, 0.55]])
    row, col = np.meshgrid(np.fft.fftfreq(128), np.fft.fftfreq(160), indexing="ij")
    error, told = [], []
    for _ in range(12):
        field = np.fft.fft2(rng.standard_normal((128, 160)))
        power = (1e-4 + row**2 + col**2) ** -0.75 * np.exp(
            -0.5 * (4 * np.pi * 0.4) ** 2 * (row**2 + col**2)
        )
        frames = []
        for down, right in 2.0 * true_px:  # 2 fine pixels per pixel
            moved = field * power * np.exp(-2j * np.pi * (row * down + col * right))
            frames.append(np.fft.ifft2(moved).real[32:96:2, 32:128:2])
        y = np.array(frames)
        y = 0.5 + 0.1 * y / y.std() + 0.004 * rng.standard_normal(y.shape)
        fit = likely_shifts(y, np.ones(y.shape, np.bool_), np.zeros((3, 2)))
        error.append((fit.offset_px - true_px)[1:])
        told.append(fit.sigma_px[1:])
    ratio = np.sqrt(np.mean(np.square(error)) / np.mean(np.square(told)))
    assert 0.7 < ratio < 1.4


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_invalid_pixels_count_for_nothing() -> None:
    burst, true_px = taken(scene("random"))
    rng = np.random.default_rng(1)
    valid = rng.random(burst.amplitude.shape) > 0.05
    valid[1, 4:7, 20:25] = False
    spoiled = np.where(valid, burst.amplitude, np.nan)
    for method, within_px in (("auto", 0.025), ("gradient", 0.05)):
        found = register(replace(burst, amplitude=spoiled, valid=valid), method=method)
        assert np.sqrt(np.mean((found.offset_px - true_px) ** 2)) < within_px


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("lost", [0, 2])
def test_a_frame_that_shows_hardly_anything_says_nothing(
    given: bool, share: float, lost: int
) -> None:
    burst, true_px = taken(scene("random"))
    seen = np.arange(4) != lost
    frames = np.array(burst.amplitude, float)
    frames[lost, :, int(share * frames.shape[2]) :] = np.nan
    planned = true_px + np.array([0.3, -0.2])
    blind = Burst.from_arrays(
        frames, offset_px=planned if given else None, pitch_mm=PITCH_MM, valid=np.isfinite(frames)
    )
    with pytest.warns(QualityWarning, match=f"frame {lost}: less than half"):
        found = register(blind)
    wrong = (found.offset_px - true_px)[seen]
    np.testing.assert_allclose(wrong, np.broadcast_to(wrong[0], (3, 2)), atol=0.03)
    assert np.all(found.offset_sigma_px[lost] > 1.0)
    np.testing.assert_array_equal(found.offset_px[lost], planned[lost] if given else 0.0)
    assert found.valid is not None
    assert found.valid[lost].any() == (given and share > 0.0)


def test_frames_that_are_not_asked_for_spoil_nothing() -> None:
    """A frame of another scene is left out where it lies first, too, and no warning is about it."""
    rng = np.random.default_rng(8)
    frames = waves(OFFSETS) + 1e-3 * rng.standard_normal(waves(OFFSETS).shape)
    stack = np.concatenate([3 * rng.random((1, *frames.shape[1:])), frames])
    with warnings.catch_warnings(action="error"):
        found = register(Burst.from_arrays(stack, pitch_mm=PITCH_MM), frames=[1, 2, 3, 4, 5])
    wrong = found.offset_px[1:] - OFFSETS
    np.testing.assert_allclose(wrong, np.broadcast_to(wrong[0], (5, 2)), atol=3e-3)
    assert np.all(found.offset_sigma_px[0] > 1.0)
    assert np.all(found.offset_sigma_px[1] == 0.0)
    stack[5] = 3 * stack[5]
    brighter = Burst.from_arrays(stack, pitch_mm=PITCH_MM)
    with pytest.warns(QualityWarning) as said:
        register(brighter, frames=[1, 2, 3, 4, 5])
    assert "that of frame 5 is 199.9 % more" in str(said[0].message)
    with pytest.warns(QualityWarning) as said:
        register(brighter, frames=[1, 2, 3, 4, 5], photometric=False)
    assert "in frame 5. Divide" in str(said[0].message)


@pytest.mark.parametrize("kind", ["four boxes", "random", "phasors"])
@pytest.mark.parametrize("share", [0.02, 0.3])
def test_light_that_drifts_is_seen_and_allowed_for(kind: str, share: float) -> None:
    """As well as where it is told of; and nothing is allowed for where the light is even."""
    for seed in (0, 1):
        burst, true_px = taken(scene(kind if kind != "phasors" else "random"), seed=seed)
        frames = burst.amplitude
        if kind == "phasors":
            frames = frames * np.exp(1j * frames)
        gain = 1.0 + share * np.random.default_rng(seed).permutation(np.linspace(0, 1, len(frames)))
        with warnings.catch_warnings(action="error"):
            even = register(burst_of(frames))
        drifting = burst_of(frames * gain[:, None, None])
        with pytest.warns(QualityWarning, match="the light of the frames differs") as said:
            found = register(drifting)
        dark, bright = (int(pick(gain)) for pick in (np.argmin, np.argmax))
        named = str(said[0].message)
        assert f"that of frame {bright} is" in named
        assert f"more than that of frame {dark}" in named
        told_share = float(named.split(" is ")[1].split(" %")[0]) / 100
        assert told_share == pytest.approx(share, rel=0.15)
        errors_px = [
            np.sqrt(np.mean((one.offset_px - true_px) ** 2))
            for one in (even, found, register(drifting, photometric=True))
        ]
        assert errors_px[1] == errors_px[2]
        assert errors_px[1] < 1.3 * errors_px[0] + 0.002


def test_what_moves_and_what_is_noise_is_no_light() -> None:
    rng = np.random.default_rng(12)
    burst, _ = taken(scene("demo"), seed=3)
    frames = burst.amplitude.copy()
    for number, frame in enumerate(frames):
        frame[4:12, 10 + 6 * number : 22 + 6 * number] = 0.9
    noise = 0.3 * np.std(frames) * rng.standard_normal((9, *frames.shape[1:]))
    offset_px = rng.uniform(-1, 1, (9, 2))
    assert gains_of_light(frames, burst.offset_px) is None
    assert gains_of_light(waves(offset_px, frames.shape[1:]) + 5 + noise, offset_px) is None
    assert (
        gains_of_light(1.02 ** np.arange(4)[:, None, None] * burst.amplitude, burst.offset_px)
        is not None
    )


def test_a_slope_that_lies_elsewhere_is_no_light() -> None:
    """Nor does a known shift pass for light; light is seen beside any shift where there is more."""
    row, col = np.meshgrid(np.arange(36.0), np.arange(44.0), indexing="ij")
    for seed in range(8):
        rng = np.random.default_rng(seed)
        shifts = rng.uniform(-1, 1, (6, 2))[:, :, None, None]
        wall = 1 + (row - shifts[:, 0]) / 100 + (col - shifts[:, 1]) / 300
        y = wall + 0.002 * rng.standard_normal(wall.shape)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", QualityWarning)
            register(burst_of(y))
        assert not any("the light of" in str(one.message) for one in caught)
        drifts = 1.02 ** np.arange(6)[:, None, None]
        assert gains_of_light(drifts * y, shifts[..., 0, 0]) is not None
        bright = y + waves(shifts[..., 0, 0], y.shape[1:])
        assert gains_of_light(bright, shifts[..., 0, 0], 2.0) is None
        assert gains_of_light(drifts * bright, shifts[..., 0, 0], 2.0) is not None


@pytest.mark.parametrize("frames", [[0, 9], [-1, 0, 1], [1, 1, 2]])
def test_frames_that_are_not_there_are_refused(frames: list[int]) -> None:
    with pytest.raises(ValueError, match="expected frames from 0 to 4, each once"):
        register(burst_of(waves(OFFSETS)), frames=frames)


@pytest.mark.parametrize(("method", "within_px"), [("auto", 0.02), ("gradient", 0.05)])
def test_frames_of_other_brightness(method: str, within_px: float) -> None:
    burst, true_px = taken(scene("four boxes"))
    gain, bias = np.array([1.0, 0.9, 1.15, 1.05]), np.array([0.0, 0.05, -0.03, 0.02])
    changed = gain[:, None, None] * burst.amplitude + bias[:, None, None]
    found = register(replace(burst, amplitude=changed), method=method, photometric=True)
    np.testing.assert_allclose(found.offset_px, true_px, atol=3 * within_px)
    assert np.sqrt(np.mean((found.offset_px - true_px) ** 2)) < within_px


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_frames_with_hardly_any_contrast_have_no_gain() -> None:
    """It grew until it was no number, and the search ended in an error of NumPy."""
    frames = np.full((3, 23, 11), 300.0)
    frames[0] = -900.0
    frames[:, 4, 5] += 1e-9
    assert np.all(np.isfinite(register(burst_of(frames), photometric=True).offset_sigma_px))


def test_many_frames_are_told_some_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    offset_px = np.random.default_rng(3).uniform(-1.0, 1.0, (11, 2))
    frames = waves(offset_px)
    frames += 0.01 * np.std(frames) * np.random.default_rng(4).standard_normal(frames.shape)
    told = {"reference": 6, "photometric": False}
    valid = np.ones(frames.shape, bool)
    whole = likely_where_telling(frames, valid, offset_px, **told)
    monkeypatch.setattr(blocks, "MOST_TOGETHER", 4)
    parts = likely_where_telling(frames, valid, offset_px, **told)
    np.testing.assert_array_equal(parts.offset_px[6], offset_px[6])
    for fit in (whole, parts):
        assert np.all(np.abs(fit.offset_px - offset_px) <= 4 * fit.sigma_px)
    np.testing.assert_allclose(parts.offset_px, whole.offset_px, atol=3e-3)
    assert np.array_equal(parts.sigma_px == 0, whole.sigma_px == 0)
    assert parts.covariance_px2.shape == whole.covariance_px2.shape
    assert parts.converged


@pytest.mark.parametrize("planned", [True, False])
@pytest.mark.parametrize(("shows", "at"), [("another scene", 0), ("another scene", 2), ("dark", 0)])
def test_a_frame_of_another_scene_is_named_and_left_out(shows: str, at: int, planned: bool) -> None:
    """The first one is what the others are held against: it spoilt all of them."""
    for seed in (60, 61):
        burst, true_px = taken(random_boxes(seed), seed=seed)
        amplitude = burst.amplitude.astype(np.float64)
        dark = 0.002 * np.random.default_rng(seed).random(amplitude[at].shape)
        other, _ = taken(random_boxes(seed + 40), seed=seed)
        amplitude[at] = dark if shows == "dark" else other.amplitude[at]
        burst = replace(burst, amplitude=amplitude)
        if not planned:
            burst = replace(burst, offset_px=0 * burst.offset_px, offset_source="unknown")
        done = "taken as given" if planned else "left out"
        with pytest.warns(QualityWarning) as said:
            found = register(burst)
        why = "shows nothing of the scene of most others"
        assert [str(one.message) for one in said] == [f"frame {at}: {why}; {done}"]
        seen = np.arange(4) != at
        error_px = (found.offset_px - true_px)[seen]
        assert np.abs(error_px - error_px.mean(axis=0)).max() < 0.02
        assert found.offset_sigma_px[seen].max() < 0.05
        assert found.valid[at].any() == planned


def test_noise_is_no_other_scene() -> None:
    """Frames of which noise hides most are like none, and count."""
    burst, _ = taken(random_boxes(62), seed=62)
    rng = np.random.default_rng(62)
    noisy = burst.amplitude + 0.5 * rng.standard_normal(burst.amplitude.shape)
    with pytest.warns(QualityWarning) as said:
        register(replace(burst, amplitude=noisy))
    assert not [one for one in said if "most others" in str(one.message)]


@pytest.mark.parametrize("photometric", [False, True])
def test_a_blank_frame_is_named_and_left_out(photometric: bool) -> None:
    """A shutter that stayed closed: it was said that the scene repeats."""
    burst, _ = taken(scene("demo"), seed=5)
    frames = np.array(burst.amplitude)
    frames[2] = 0.25
    with pytest.warns(QualityWarning, match="frame 2: all valid pixels are alike, .* left out"):
        found = register(
            Burst.from_arrays(frames, pitch_mm=PITCH_MM, offset_px=None), photometric=photometric
        )
    others = [k for k in range(len(frames)) if k != 2]
    alone = register(
        Burst.from_arrays(frames[others], pitch_mm=PITCH_MM, offset_px=None),
        photometric=photometric,
    )
    apart = found.offset_px[others] - alone.offset_px
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-9)
    assert not found.valid[2].any()
    assert found.valid[others].all()
    with pytest.raises(ValueError, match="expected valid pixels that differ in at least 2 frames"):
        register(burst_of(np.full((3, 9, 12), 7.0)))


def test_phasors_and_distances() -> None:
    frames = waves(OFFSETS[:3])
    found = register(burst_of(frames * np.exp(1j * (1.0 + frames))))
    np.testing.assert_allclose(found.offset_px, OFFSETS[:3], atol=2e-3)
    flat = np.full(frames.shape, 0.5)
    found = register(burst_of(flat, distance_m=frames), channel="distance")
    np.testing.assert_allclose(found.offset_px, OFFSETS[:3], atol=1e-3)


def test_too_little_texture_is_said_with_its_direction() -> None:
    rng = np.random.default_rng(0)
    stripes = np.broadcast_to(waves(np.zeros((1, 2)), (18, 40))[0][:1], (3, 18, 40))
    burst = burst_of(stripes + 0.002 * rng.standard_normal((3, 18, 40)))
    with pytest.warns(QualityWarning, match=r"along row: .* known to \d"):
        found = register(burst)
    assert found.offset_sigma_px[1, 0] > 0.05 > found.offset_sigma_px[1, 1]


def test_given_offsets_help_where_the_frames_say_nothing() -> None:
    rng = np.random.default_rng(0)
    given = np.array([[0.0, 0.0], [0.25, 0.1], [0.4, -0.2]])
    wide = waves(given * (0, 1), (18, 40))[:, :1]
    noise = 0.002 * rng.standard_normal((3, 18, 40))
    told = np.full((3, 2), 0.02)
    burst = burst_of(np.broadcast_to(wide, (3, 18, 40)) + noise, given, offset_sigma_px=told)
    with warnings.catch_warnings():
        warnings.simplefilter("error", QualityWarning)
        found = register(burst, use_given=True)
    np.testing.assert_allclose(found.offset_px, given, atol=0.05)


def test_the_eia_chart_lies_on_its_grid_of_quarter_pixels(reference_dir: Path) -> None:
    frames = np.load(reference_dir / "real_sequences" / "mdsp_eia.npz")["frames"][[0, 2, 8, 10]]
    found = register(burst_of(frames))
    nominal = -np.array([[0.0, 0.0], [0.0, 0.5], [0.5, 0.0], [0.5, 0.5]])
    np.testing.assert_allclose(found.offset_px, nominal, atol=0.04)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"method": "magic"}, "auto, gradient, phase"),
        ({"reference": 5}, "reference from 0 to 4"),
        ({"channel": "distance"}, "no distance_m"),
        ({"channel": "colour"}, "amplitude"),
        ({"use_given": True}, "offset_sigma_px"),
    ],
)
def test_mistakes_are_named(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        register(burst_of(waves(OFFSETS)), **change)  # type: ignore[arg-type]


def test_bursts_that_cannot_be_registered() -> None:
    with pytest.raises(ValueError, match="at least 2 frames"):
        register(burst_of(waves(OFFSETS[:1])))
    dead = waves(OFFSETS[:2])
    dead[1] = np.nan
    with pytest.raises(ValueError, match="valid pixels that differ in at least 2 frames"):
        register(burst_of(dead, valid=np.isfinite(dead)))
    with pytest.raises(ValueError, match="share at least 4 px"):
        likely_shifts(
            waves(OFFSETS[:2]), np.ones((2, 21, 34), np.bool_), np.array([[0, 0], [18, 0]])
        )
    with pytest.raises(ValueError, match="4 x 4"):
        phase_correlation(np.zeros((3, 9)), np.zeros((3, 9)))


def test_a_part_that_does_not_know_where_it_lies_says_nothing_of_the_others() -> None:
    frames, known = np.zeros((2, 16, 64)), np.ones((2, 16, 64), np.bool_)
    away = iter([[0.01, 0.01], [-0.01, -0.01], [0.01, -0.01], [0.01, -30.0]])
    errors = iter([[0.01, 0.01]] * 3 + [[0.01, 0.3]])  # its edges run along the rows

    def estimate(*_: object) -> tuple[np.ndarray, np.ndarray]:
        return np.array([[0.0, 0.0], next(away)]), np.array([[0.0, 0.0], next(errors)])

    found = scatter_over_blocks(estimate, frames, known, np.zeros((2, 2)))
    # Of n that each say 0.01 px: 4 / 3 times their sum of squares over n^2.
    expected = 4 / 3 * 0.01**2 * np.array([1 / 4, 1 / 3])
    assert np.diag(found.covariance_px2)[2:] == pytest.approx(expected)


@pytest.mark.parametrize("said", [False, True])
def test_what_is_known_beside_the_frames_counts_by_its_precision(said: bool) -> None:
    """The product of two Gaussians, of errors that go together in the one and not in the other."""
    rng = np.random.default_rng(9)
    root = rng.standard_normal((6, 6))
    own, sigma_px = root @ root.T, rng.uniform(0.3, 2.0, (3, 2))
    found_px, given_px = rng.standard_normal((2, 3, 2))
    fit = ShiftFit(found_px, own, np.ones(3), 0.1, converged=True)
    both = with_given(fit, given_px, sigma_px, said=said)
    precision = [np.linalg.inv(own), np.diag(sigma_px.ravel() ** -2)]
    covariance = np.linalg.inv(sum(precision))
    np.testing.assert_allclose(both.covariance_px2, covariance, atol=1e-10)
    mean = covariance @ (precision[0] @ found_px.ravel() + precision[1] @ given_px.ravel())
    np.testing.assert_allclose(both.offset_px, mean.reshape(3, 2) if said else found_px, atol=1e-9)


def test_an_error_just_beyond_the_wanted_one_is_not_rounded_to_it() -> None:
    sigma_px, none = np.array([[0.0, 0.0], [0.0539, 0.01]]), np.zeros((2, 2))
    with pytest.warns(QualityWarning, match=r"0\.0539 px only \(want 0\.05 px\)"):
        _warn_if_poor(sigma_px, none, np.arange(2), converged=True, apart=1.0)
