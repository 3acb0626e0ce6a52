"""Frames one at a time: as good as whole bursts, quick while the scene rests, and not fooled."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from mosaic import canvas, observe, phasor_mosaic

import lensshift
from lensshift.core.errors import QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.types import Estimate, Frame, Reconstruction, Status
from lensshift.core.units import distance_to_phase
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.forward.prediction import FramePredictor
from lensshift.reconstruction import stream
from lensshift.reconstruction.displacement import ALLOWED_SHIFT_PX
from lensshift.reconstruction.following import Followed, View
from lensshift.reconstruction.learned.phasors import LOW_PASS_PX
from lensshift.reconstruction.photometry import light_since, lights
from lensshift.reconstruction.places import Known

SHAPE, SCALE = (21, 26), 2
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)])
SQUARE_PIXEL_PX = 1 / np.sqrt(12)
PER_M = distance_to_phase(1.0, 15e6)
INNER = (slice(4, -4), slice(4, -4))


def scene(seed):
    return observe(canvas(np.random.default_rng(seed), SHAPE), SHAPE, rng=np.random.default_rng(0))


def clean_frames(truth, offset_px=SQUARE_PX):
    model = forward_model(SHAPE, SCALE, offset_px, blur=GaussianBlur(SQUARE_PIXEL_PX))
    return model.operator.forward(truth)


def camera(**settings):
    told = {"psf_sigma_px": SQUARE_PIXEL_PX} | settings
    return lensshift.stream(SQUARE_PX, SCALE, shape=SHAPE, **told)


def error(result, truth):
    return float(np.sqrt(np.mean((np.abs(result.amplitude.image) - np.abs(truth))[INNER] ** 2)))


def run(one, clean, count, *, sigma, rng, first=0, place=None):
    """Step through frames of a resting scene; the places go on round and round."""
    found = []
    for number in range(first, first + count):
        y = clean[number % 4]
        noise = sigma * rng.standard_normal(y.shape)
        if y.dtype.kind == "c":
            noise = noise + 1j * sigma * rng.standard_normal(y.shape)
        found.append(one.step(y + noise, place=None if place is None else number % 4))
    return found


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_live_pictures_keep_the_doubt_about_the_plan() -> None:
    clean, rng = clean_frames(scene(12).truth), np.random.default_rng(12)
    for plan_px, expected in ((-SQUARE_PX, True), (SQUARE_PX, False)):
        one = lensshift.stream(plan_px, SCALE, shape=SHAPE, pace="live")
        found = run(one, clean, 12, sigma=0.005, rng=rng)[-8:]
        assert "live" in {picture.settings["pace"] for picture in found}
        doubted = [picture.amplitude.status is Status.CONTRADICTED for picture in found]
        assert doubted == [expected] * 8


@pytest.mark.parametrize("sigma", [0.02, pytest.param(0.005, marks=pytest.mark.slow)])
def test_a_resting_scene_is_as_sharp_at_the_live_pace(sigma):
    """Over scenes: each has one picture at that pace, whose error is a matter of luck."""
    ratios = {"live": [], "auto": []}
    for seed in range(11, 17):
        truth, rng = scene(seed).truth, np.random.default_rng(seed)
        clean, errors = clean_frames(truth), {}
        for pace in ("live", "refined", "auto"):
            found = run(camera(pace=pace), clean, 12, sigma=sigma, rng=rng)
            errors[pace] = np.mean([error(one, truth) for one in found[4:]])
            paces = [one.settings["pace"] for one in found[4:]]
            assert paces == {"live": ["live"] * 8, "refined": ["refined"] * 8}.get(
                pace, (["live"] * 3 + ["refined"]) * 2
            )
        for pace, ones in ratios.items():
            ones.append(errors[pace] / errors["refined"])
    for ones in ratios.values():
        assert np.exp(np.mean(np.log(ones))) < 1.06  # 0.5 dB


def test_a_large_level_streams_as_well():
    truth = 290 + 0.5 * scene(14).truth
    clean, errors = clean_frames(truth), {}
    for pace in ("live", "refined"):
        found = run(camera(pace=pace), clean, 12, sigma=0.01, rng=np.random.default_rng(2))
        errors[pace] = np.mean([error(one, truth) for one in found[8:]])
        assert found[-1].settings["pace"] == pace
    assert errors["live"] < 1.1 * errors["refined"]


def test_phasors_stream_as_well():
    mosaic, rng = phasor_mosaic(3, SHAPE), np.random.default_rng(0)
    clean, errors = clean_frames(mosaic.truth), {}
    for pace in ("live", "refined"):
        one = camera(pace=pace, modulation_hz=15e6, channel="phasor")
        found = run(one, clean, 14, sigma=mosaic.sigma, rng=rng)
        errors[pace] = np.mean([error(r, mosaic.truth) for r in found[8:]])
        assert found[-1].distance_m is not None
        assert found[-1].settings["pace"] == pace
    assert errors["live"] < 1.1 * errors["refined"]


@pytest.mark.slow
def test_phasors_of_which_smaller_pixels_are_asked_stream_as_well():
    """The second look at their light began with the channels of phasors, beyond its arrays."""
    steps = (-1 / 3, 0.0, 1 / 3)
    plan_px = np.array([(row, col) for row in steps for col in steps])
    mosaic, rng = phasor_mosaic(3, SHAPE), np.random.default_rng(0)
    clean, errors = clean_frames(mosaic.truth, plan_px), {}
    for pace in ("live", "refined"):
        one = lensshift.stream(
            plan_px, SCALE, shape=SHAPE, pace=pace, modulation_hz=15e6, channel="phasor",
            psf_sigma_px=SQUARE_PIXEL_PX,
        )  # fmt: skip
        found = []
        for y in [*clean, *clean, *clean[:4]]:  # the misfit is good for a round
            noise = rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)
            found.append(one.step(y + mosaic.sigma * noise))
        errors[pace] = np.mean([error(r, mosaic.truth) for r in found[9:]])
        assert found[-1].settings["pace"] == pace
    assert errors["live"] < 1.1 * errors["refined"]


def test_the_refined_pace_is_reconstruct():
    truth = scene(21).truth
    y = clean_frames(truth) + 0.01 * np.random.default_rng(1).standard_normal((4, *SHAPE))
    one = camera(pace="refined")
    for number in range(4):
        found = one.step(y[number])
        burst = lensshift.Burst.from_arrays(
            y[: number + 1], offset_px=SQUARE_PX[: number + 1], pitch_mm=1.0
        )
        expected = lensshift.reconstruct(burst, SCALE, psf_sigma_px=SQUARE_PIXEL_PX)
        np.testing.assert_array_equal(found.amplitude.image, expected.amplitude.image)
        assert found.settings["places"] == list(range(number + 1))


@pytest.mark.parametrize("told", [{"modulation_hz": 15e6}, {"psf_sigma_px": None}, {}])
def test_what_was_held_against_a_scene_that_rests_is_no_other_picture(told):
    """Of light and of phasors, of a response that was told and of one that the frames show."""
    truth = phasor_mosaic(3, SHAPE).truth if "modulation_hz" in told else scene(22).truth
    clean, rng, one = clean_frames(truth), np.random.default_rng(1), camera(**told)
    found, computed = run(one, clean, 8, sigma=0.01, rng=rng)[-1], 0
    for number in range(8, 20):
        noise = rng.standard_normal(SHAPE) + (1j if np.iscomplexobj(clean) else 0)
        before, found = found, one.step(clean[number % 4] + 0.01 * noise)
        if found.settings["pace"] == "live":
            continue
        computed += 1
        response = {} if found.settings["psf_source"] == "assumed" else {
            "psf_sigma_px": found.settings["psf_sigma_px"]
        }  # fmt: skip
        alone = lensshift.reconstruct(one.window, SCALE, **response)
        for name, expected in alone.channels.items():
            for got, whole in (
                (found.channels[name].image, expected.image),
                (np.asarray(found.channels[name].std), np.asarray(expected.std)),
            ):
                np.testing.assert_allclose(got, whole, rtol=1e-4, atol=1e-5)
        for name in ("psf_sigma_px", "psf_source", "psf_std_px"):
            assert found.settings.get(name) == before.settings.get(name)
    assert computed == 3


@pytest.mark.parametrize(
    ("told_px", "ends", "wrong"),
    [(SQUARE_PIXEL_PX, (SQUARE_PIXEL_PX, 0.0), "contradict offset_px"),
     (0.6, (SQUARE_PIXEL_PX, 1.0), "sharper than psf_sigma_px 0.6")],
)  # fmt: skip
def test_a_lens_that_slowly_goes_lame_or_into_focus_is_said(told_px, ends, wrong):
    """No frame contradicts those before, and a stream at rest does not ask each time."""
    truth, rng, one = scene(22).truth, np.random.default_rng(3), camera(psf_sigma_px=told_px)
    widths_px, shares = (np.r_[np.linspace(a, b, 140), np.full(80, b)]
                         for a, b in zip((told_px, 1.0), ends, strict=True))  # fmt: skip
    paces = set()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", QualityWarning)
        for number, (width_px, share) in enumerate(zip(widths_px, shares, strict=True)):
            at_px = share * SQUARE_PX[number % 4][None]
            model = forward_model(SHAPE, SCALE, at_px, blur=GaussianBlur(width_px))
            y = model.operator.forward(truth)[0]
            found = one.step(y + 0.01 * rng.standard_normal(SHAPE))
            paces.add(found.settings["pace"])
    assert paces == {"live", "refined"}
    assert found.amplitude.status is Status.CONTRADICTED
    assert any(wrong in str(text.message) for text in said)


def test_another_scene_is_noticed_and_shown_within_a_round():
    before, after = scene(31).truth, scene(32).truth
    rng, one = np.random.default_rng(5), camera()
    run(one, clean_frames(before), 6, sigma=0.02, rng=rng)
    with pytest.warns(QualityWarning, match="scene changed"):
        found = run(one, clean_frames(after), 4, sigma=0.02, rng=rng, first=6)
    events = [result.settings["event"] for result in found]
    assert events == ["scene changed", None, None, None]
    alone = run(camera(), clean_frames(after), 4, sigma=0.02, rng=rng)
    assert error(found[-1], after) < 1.1 * error(alone[-1], after)


@pytest.mark.parametrize("waves", [True, False])
def test_more_noise_is_no_other_scene(waves):
    """As when the sun comes out: all frames of before were left out, and one was left."""
    ratios = []
    for seed in (91, 92, 93):
        truth = phasor_mosaic(seed, SHAPE).truth if waves else 0.2 + scene(seed).truth
        clean, rng, one = (
            clean_frames(truth),
            np.random.default_rng(seed),
            camera(modulation_hz=15e6),
        )
        sigma = 0.02 * np.abs(clean).mean()
        run(one, clean, 9, sigma=sigma, rng=rng)
        with warnings.catch_warnings():
            warnings.simplefilter("error", QualityWarning)
            found = run(one, clean, 4, sigma=5 * sigma, rng=rng, first=9)
        assert {picture.settings["event"] for picture in found} == {None}
        noisy = clean[1] + 5 * sigma * rng.standard_normal(SHAPE)
        alone = camera(modulation_hz=15e6).step(noisy, place=1)
        ratios.append(error(found[0], truth) / error(alone, truth))
    assert max(ratios) < 0.6


def wall_and_boxes(seed):
    """Return phasors of a wall with four boxes before it, each of its own light and distance."""
    rng, (rows, cols) = np.random.default_rng(seed), (SCALE * SHAPE[0], SCALE * SHAPE[1])
    light, far_m = np.full((rows, cols), rng.uniform(0.2, 2)), np.full((rows, cols), 4.0)
    far_m += rng.uniform(-1, 1)
    for top, left in zip(rng.integers(0, rows - 12, 4), rng.integers(0, cols - 12, 4), strict=True):
        box = (slice(top, top + rng.integers(5, 12)), slice(left, left + rng.integers(5, 12)))
        light[box], far_m[box] = rng.uniform(0.2, 3), rng.uniform(1, 3)
    return light * np.exp(1j * PER_M * far_m)


def steps(one, truth, numbers, sigma, rng):
    """Step through frames of amplitudes and distances; return pictures and what was said."""
    clean, found = clean_frames(truth), []
    with warnings.catch_warnings(record=True, action="always", category=QualityWarning) as said:
        for number in numbers:
            z = clean[number % 4] + sigma * (
                rng.standard_normal(SHAPE) + 1j * rng.standard_normal(SHAPE)
            )
            far_m = np.angle(z) % (2 * np.pi) / PER_M
            seen = Frame(np.abs(z), far_m, np.ones(SHAPE, bool), float(number))
            found.append(one.step(seen, place=number % 4))
    return found, [str(text.message) for text in said]


@pytest.mark.parametrize("seed", range(301, 305))
def test_another_scene_after_noise_is_no_other_light(seed):
    """A wall that takes the place of another one is a gain to what follows frames."""
    rng, one = np.random.default_rng(seed), camera(modulation_hz=15e6)
    before, after = wall_and_boxes(seed), wall_and_boxes(seed + 100)
    steps(one, before, range(5), 0.01, rng)
    steps(one, before, range(5, 10), 0.04, rng)
    found, said = steps(one, after, range(10, 14), 0.01, rng)
    assert [picture.settings["event"] for picture in found] == ["scene changed", None, None, None]
    assert not any("something moved" in text or "does not fit" in text for text in said)


def test_a_lens_that_rests_streams_as_well():
    before, after = scene(33).truth, scene(34).truth
    rng, at = np.random.default_rng(5), np.zeros((1, 2))
    one = lensshift.stream(at, SCALE, shape=SHAPE)
    for truth, events in ((before, [None, None]), (after, ["scene changed", None])):
        y = clean_frames(truth, at)[0]
        for event in events:
            noisy = y + 0.02 * rng.standard_normal(SHAPE)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", QualityWarning)
                found = one.step(noisy)
            assert found.settings["event"] == event
            alone = lensshift.stream(at, SCALE, shape=SHAPE).step(noisy)
            assert error(found, truth) < 1.1 * error(alone, truth)


def test_lost_frames_are_noticed():
    truth, rng = scene(41).truth, np.random.default_rng(6)
    clean, one = clean_frames(truth), camera()
    usual = error(run(one, clean, 8, sigma=0.02, rng=rng)[-1], truth)
    with pytest.warns(QualityWarning, match="frames were lost"):
        found = run(one, clean, 4, sigma=0.02, rng=rng, first=10)  # two are missing
    assert [result.settings["event"] for result in found] == ["frames lost", None, None, None]
    assert all(error(result, truth) < 1.2 * usual for result in found)


def quiet_steps(one, frames):
    """Return the last frame's place after each step, and what was said to have happened."""
    at, events = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        for y in frames:
            events.append(one.step(y).settings["event"])
            at.append(one.frames[-1])
    return at, events


@pytest.mark.parametrize("seed", range(6))
def test_a_camera_that_was_knocked_loses_no_frames(seed):
    """Its first frames may fit elsewhere on the plan; all pictures a round later are right."""
    rng = np.random.default_rng(seed)
    truth, knock_px = scene(seed).truth, rng.uniform(0.3, 1.2, 2) * rng.choice([-1, 1], 2)
    before, after = clean_frames(truth), clean_frames(truth, SQUARE_PX + knock_px)
    frames = [before[k % 4] for k in range(9)] + [after[k % 4] for k in range(9, 23)]
    one = camera()
    at, events = quiet_steps(one, [y + 0.01 * rng.standard_normal(SHAPE) for y in frames])
    assert at[13:] == [k % 4 for k in range(13, 23)]
    assert "frames lost" not in events[13:]


@pytest.mark.parametrize("lost", [1, 2, 3])
@pytest.mark.parametrize("phase", [0.3, 2.0])
def test_lost_frames_of_a_smooth_scene_are_noticed_by_all_pixels(lost, phase):
    """Of a wave of 20 px, no pixel of which contradicts."""
    r, c = np.indices((2 * SHAPE[0], 2 * SHAPE[1])) / 2
    truth = 10 + np.sin(2 * np.pi * r / 20 + phase) + np.sin(2 * np.pi * (c + r / 3) / 20)
    rng, clean = np.random.default_rng(lost), clean_frames(truth)
    order = [*range(9), *range(9 + lost, 17 + lost)]
    frames = [clean[k % 4] + 0.02 * rng.standard_normal(SHAPE) for k in order]
    at, events = quiet_steps(camera(), frames)
    assert at == [k % 4 for k in order]
    assert [k for k, event in enumerate(events) if event] == [9]


@pytest.mark.parametrize("seed", range(6))
def test_what_moves_before_a_smooth_scene_loses_no_frames(seed):
    rng = np.random.default_rng(seed)
    r, c = np.indices((2 * SHAPE[0], 2 * SHAPE[1])) / 2
    waves = 10 + np.sin(2 * np.pi * r / 20) + np.sin(2 * np.pi * (c + r / 3) / 20)
    frames = []
    for k in range(24):
        truth, row, col = waves.copy(), 8 + 3 * seed, int(4 + 1.5 * max(k - 8, 0))
        truth[row : row + 6, col : col + 6] = 14
        frames.append(clean_frames(truth)[k % 4] + 0.02 * rng.standard_normal(SHAPE))
    at, _ = quiet_steps(camera(), frames)
    assert at == [k % 4 for k in range(24)]


@pytest.mark.parametrize("full", [False, True])
def test_a_frame_that_shows_nothing_is_named_and_left_out(full):
    clean, one = clean_frames(scene(11).truth), camera()
    dark = np.full(SHAPE, np.nan)
    with pytest.warns(QualityWarning, match="place 0 shows nothing"):
        one.take(dark)
    with pytest.raises(ValueError, match="a frame with a valid pixel"):
        one.picture()
    run(one, clean, 7 if full else 3, sigma=1e-3, rng=np.random.default_rng(1), first=1)
    at = 0 if full else 2  # of the round before, or the first of its place
    one.take(clean[0], place=0)
    with pytest.warns(QualityWarning, match=f"place {at} shows nothing"):
        found = one.step(dark, place=at)
    assert found.settings["event"] == "frames lost"
    assert found.settings["places"] == sorted({0, 1, 2, 3} - {at})
    kept = one.window
    alone = lensshift.reconstruct(kept, SCALE, psf_sigma_px=SQUARE_PIXEL_PX)
    np.testing.assert_array_equal(found.amplitude.image, alone.amplitude.image)
    assert one.step(clean[at], place=at).settings["places"] == [0, 1, 2, 3]


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("far", [True, False])
def test_what_is_no_number_is_not_valid_whatever_a_frame_says(wrong, far):
    """It ended each step of a round in an error, after the frame was taken."""
    clean, one = clean_frames(0.2 + scene(11).truth), camera()
    for number in range(8):
        y = clean[number % 4] + 1e-3 * np.random.default_rng(number).standard_normal(SHAPE)
        distance_m = y + 1 if far else None
        if number == 5:
            (y if distance_m is None else distance_m)[3, 4] = wrong
        found = one.step(Frame(y, distance_m, np.ones(SHAPE, bool), 0.0))
        assert np.isfinite(found.amplitude.image).all()
        assert np.sum(~one.window.valid) == (number >= 5)


@pytest.mark.parametrize("count", [4, 7])
def test_after_a_round_of_nothing_the_picture_of_before_stays(count):
    """It ended in an error about a first picture."""
    clean, one, rng = clean_frames(scene(11).truth), camera(), np.random.default_rng(1)
    run(one, clean, 4, sigma=1e-3, rng=rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        found = run(one, np.full_like(clean, np.nan), count - 1, sigma=0, rng=rng)
        one.take(np.full(SHAPE, np.nan))
    with pytest.warns(QualityWarning, match="no frame of a round shows anything"):
        last = one.picture()
    assert (last.settings["places"], last.settings["event"]) == ([], "frames lost")
    np.testing.assert_array_equal(last.amplitude.image, found[2].amplitude.image)
    with pytest.raises(ValueError, match="no frame shows anything"):
        _ = one.window
    after = run(one, clean, 4, sigma=1e-3, rng=rng, first=count)
    assert [len(picture.settings["places"]) for picture in after] == [1, 2, 3, 4]


@pytest.mark.filterwarnings("ignore:the light changed")
@pytest.mark.parametrize("waves", [True, False])
def test_pixels_that_do_not_follow_the_scene_are_left_out_as_of_a_burst(waves):
    """A stream did not look for them: its light was up to 14 times as far off."""
    hot = np.zeros(SHAPE, bool)
    hot[[6, 14], [8, 19]] = True
    for seed in (71, 72, 73):
        truths = [
            phasor_mosaic(k, SHAPE).truth if waves else 0.2 + scene(k).truth
            for k in (seed, seed + 10)
        ]
        rng, one, said = np.random.default_rng(seed), camera(modulation_hz=15e6), []
        for number in range(24):  # the light changes, and then the scene
            truth = truths[number >= 16] * (1.5 if number in (9, 10, 11) else 1)
            y = clean_frames(truth)[number % 4] + 0.005 * rng.standard_normal(SHAPE)
            y[hot] = 20.0
            with warnings.catch_warnings(record=True, action="always") as told:
                found = one.step(y)
            said.extend(str(text.message) for text in told)
            if number >= 3:
                assert not np.any(one.window.valid & hot)
            if number in (3, 7, 15, 23):
                marked = lensshift.Burst.from_arrays(
                    one.window.amplitude, offset_px=SQUARE_PX, pitch_mm=1.0,
                    modulation_hz=15e6, valid=one.window.valid & ~hot,
                )  # fmt: skip
                alone = lensshift.reconstruct(marked, SCALE, psf_sigma_px=SQUARE_PIXEL_PX)
                assert error(found, truth) < 1.15 * error(alone, truth)
        assert sum("do not follow the scene" in text for text in said) == 1


def test_a_blank_frame_is_lost_and_a_dark_scene_is_not():
    clean, one = clean_frames(scene(11).truth), camera()
    run(one, clean, 4, sigma=1e-3, rng=np.random.default_rng(1))
    dark = np.zeros(SHAPE)
    with pytest.warns(QualityWarning, match="place 0 shows nothing"):
        assert one.step(dark).settings["places"] == [1, 2, 3]
    for place in (1, 2):
        with pytest.warns(QualityWarning, match=f"place {place} shows nothing"):
            one.take(dark)
    with pytest.warns(QualityWarning, match="scene changed"):
        found = one.step(dark)  # nothing else is left: the light is out
    assert found.settings["places"] == [3]
    np.testing.assert_allclose(found.amplitude.image, 0.0, atol=1e-6)


def test_a_scene_that_rests_asks_no_solver(monkeypatch):
    calls, solve = [], stream.reconstruct
    monkeypatch.setattr(stream, "reconstruct", lambda *a, **k: calls.append(1) or solve(*a, **k))
    clean, rng = clean_frames(scene(16).truth), np.random.default_rng(1)
    for pace, expected in (("live", 4), ("auto", 4 + 2)):
        calls.clear()
        found = run(camera(pace=pace), clean, 12, sigma=0.02, rng=rng)[-2]
        assert len(calls) == expected
        assert (
            found.amplitude.misfit.shape == found.amplitude.image.shape == found.amplitude.std.shape
        )


@pytest.mark.parametrize("seed", [21, 22])
def test_light_that_flickers_is_followed_at_once(seed):
    truth, rng = 0.3 + scene(seed).truth, np.random.default_rng(seed)
    one, clean = camera(pace="live"), clean_frames(truth)
    before = run(one, clean, 8, sigma=0.01, rng=rng)[-1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        after = run(one, 1.08 * clean, 1, sigma=0.01, rng=rng)[0]
    assert after.settings["pace"] == "live"
    ratio = (after.amplitude.image / before.amplitude.image)[INNER]
    assert abs(np.median(ratio) - 1.08) < 0.01
    assert error(after, 1.08 * truth) < 0.5 * error(before, 1.08 * truth)


@pytest.mark.parametrize("seed", [3, 5])
def test_phasors_follow_light_and_distance_at_once(seed):
    mosaic, rng = phasor_mosaic(seed, SHAPE), np.random.default_rng(seed)
    one = camera(pace="live", modulation_hz=15e6, channel="phasor")
    clean = clean_frames(mosaic.truth)
    before = run(one, clean, 8, sigma=0.1 * mosaic.sigma, rng=rng)[-1]
    after = run(one, 1.05 * np.exp(0.04j) * clean, 1, sigma=0.1 * mosaic.sigma, rng=rng)[0]
    assert after.settings["pace"] == "live"
    ratio = (after.amplitude.image / before.amplitude.image)[INNER]
    np.testing.assert_allclose(ratio, 1.05, atol=0.01)
    for found, expected in (
        (after.distance_m.image, before.distance_m.image),  # of dark surfaces too
        (after.distance_m.predict(1), before.distance_m.predict(1)),
    ):
        turn_rad = np.angle(np.exp(1j * (found - expected) * PER_M))
        assert np.sqrt(np.mean((turn_rad[INNER] - 0.04) ** 2)) < 0.004
    np.testing.assert_allclose(
        after.amplitude.predict(1), 1.05 * before.amplitude.predict(1), rtol=0.01
    )


def views(rest, other):
    """Return two frames of one place beside a picture of a level, and what they are more."""
    model = forward_model(rest.shape, 1, np.zeros((1, 2)), blur=GaussianBlur(0.0))
    valid = np.ones(rest.shape, bool)
    return (View(model, np.ones(rest.shape), one, valid, 0.1) for one in (rest, other))


@pytest.mark.parametrize("turn", [1.0, np.exp(0.7j)])
def test_errors_of_shifts_and_noise_leave_the_variance_of_a_view(turn):
    """A ramp whose frames lie off by 0.1 px (rms) along either axis; of each component."""
    rng, draws, sigma, slopes = np.random.default_rng(3), 2000, 0.02, np.array([0.3, -0.5])
    row, col = np.indices((7, 11))
    seen = turn * (slopes[0] * row + slopes[1] * col)
    model = forward_model(seen.shape, 1, np.zeros((1, 2)), blur=GaussianBlur(0.0))
    noise = sigma * rng.standard_normal((2, draws, *seen.shape))
    off = ALLOWED_SHIFT_PX * rng.standard_normal((draws, 2)) @ slopes * turn
    rest = off[:, None, None] + (noise[0] + 1j * noise[1] if turn != 1.0 else noise[0])
    squares = [View(model, seen, one, np.ones(seen.shape, bool), sigma).squares for one in rest]
    variance = View(model, seen, rest[0], np.ones(seen.shape, bool), sigma).variance
    np.testing.assert_allclose(
        np.mean(squares, axis=0)[1:-1, 1:-1], variance[1:-1, 1:-1], rtol=0.15
    )


@pytest.mark.parametrize(("size", "left"), [(1.0, 0.0), (0.4, 0.0), (-1.0, -1.0), (1.5, 0.5)])
def test_what_was_left_before_is_no_news(size, left):
    """As much of it as is seen again, but no more than there was and none turned round."""
    rest = np.random.default_rng(1).standard_normal((9, 14))
    new, old = views(size * rest, rest)
    np.testing.assert_allclose(new.since(old).rest, left * rest, atol=1e-12)


def test_noise_of_the_frame_before_is_not_taken_off():
    rng = np.random.default_rng(2)
    new, old = views(*rng.standard_normal((2, 60, 80)))
    assert np.std(new.since(old).rest - new.rest) < 0.2


@pytest.mark.parametrize("size", [0.01, 0.3, -0.5])
def test_a_change_of_level_is_that_change_less_what_noise_may_be(size):
    """The variance of a Gaussian mean of width g is that of a pixel over 4 pi g^2."""
    new, _ = views(np.full((9, 14), size), np.zeros((9, 14)))
    share = max(0.0, 1 - 0.1**2 / (4 * np.pi * LOW_PASS_PX**2) / size**2)
    np.testing.assert_allclose(new.change, size * share)
    np.testing.assert_allclose(new.without(new.change).rest, size * (1 - share), atol=1e-12)


def test_noise_is_no_change():
    rest = 0.1 * np.random.default_rng(4).standard_normal((60, 80))
    new, _ = views(rest, rest)
    mean = 0.1 / np.sqrt(4 * np.pi * LOW_PASS_PX**2)
    assert np.std(new.change) < 0.4 * mean


@pytest.mark.parametrize("factor", [1.0, 0.1j, 3.0])
@pytest.mark.parametrize("seed", [6, 7])
def test_what_follows_is_as_unsure_as_it_errs(factor, seed):
    """Frames of a level, or of one phasor, whose brightness a first frame tells and a second."""
    rng, sigma, v, level = np.random.default_rng(seed), 0.03, 0.0, 1.0 + 0j * factor
    shape = (60, 80)
    model = forward_model(shape, 1, np.zeros((1, 2)), blur=GaussianBlur(0.0))
    picture = np.full(shape, level)
    for _ in range(3):
        noise = rng.standard_normal((2, *shape))
        noise = noise[0] + 1j * noise[1]
        rest = factor + sigma * noise - picture
        view = View(model, picture, rest, np.ones(shape, bool), sigma)
        v, picture = view.unsure(v), picture * (1 + view.change)
        if factor != 1:
            errors = np.abs(picture / factor - 1) ** 2 / 2
            assert np.mean(v) == pytest.approx(np.mean(errors), rel=0.3)
    mean = (sigma / abs(factor)) ** 2 / (4 * np.pi * LOW_PASS_PX**2)
    assert np.mean(v) < (0.5 if factor == 1 else 1.1) * mean


def test_a_level_that_follows_is_as_unsure_as_it_errs():
    rng = np.random.default_rng(8)
    new, _ = views(0.3 + 0.1 * rng.standard_normal((60, 80)), np.zeros((60, 80)))
    errors = (new.change - 0.3) ** 2
    assert np.mean(new.unsure(0.0)) == pytest.approx(np.mean(errors), rel=0.3)
    none, _ = views(np.zeros((60, 80)), np.zeros((60, 80)))
    np.testing.assert_allclose(none.unsure(0.7), 0.7)  # nothing was taken: all is as it was


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("factor", [0.2, 0.05])
def test_std_holds_what_follows_light_that_sinks(factor, seed):
    """It was that of the bright picture: two held 0.2 to 0.7 of the distances."""
    mosaic, rng = phasor_mosaic(seed, SHAPE), np.random.default_rng(seed)
    one, clean = camera(pace="live", modulation_hz=15e6), clean_frames(mosaic.truth)
    before = run(one, clean, 8, sigma=mosaic.sigma, rng=rng)[-1]
    after = run(one, factor * clean, 4, sigma=mosaic.sigma, rng=rng)[-1]
    assert after.settings["pace"] == "live"
    turned = np.exp(1j * PER_M * after.distance_m.image) / mosaic.truth
    off_m = np.abs(np.angle(turned)) / PER_M
    assert np.mean(off_m < 2 * after.distance_m.std) > 0.92
    assert np.mean(after.distance_m.std) > np.mean(before.distance_m.std)
    off = np.abs(after.amplitude.image - factor * np.abs(mosaic.truth))
    assert np.mean(off < 2 * after.amplitude.std) > 0.9
    assert np.mean(after.amplitude.std) < 3 * np.sqrt(np.mean(off**2))


def test_std_of_a_scene_that_rests_stays():
    for kind in (scene(27).truth, phasor_mosaic(7, SHAPE).truth):
        one = camera(pace="live", modulation_hz=15e6)
        found = run(one, clean_frames(kind), 20, sigma=0.02, rng=np.random.default_rng(3))
        for name, last in found[-1].channels.items():
            # Phases of two pictures draw apart by a few per cent in the first round.
            settled = np.mean(found[7].channels[name].std ** 2)
            assert 0.97 < np.sqrt(np.mean(last.std**2) / settled) < 1.03


def test_gains_of_the_frames_and_a_least_of_zero_hold_for_what_follows():
    """Frames of other gains, a scene with black in it, and less light in the last frame."""
    truth, rng = np.maximum(scene(25).truth - 0.4, 0), np.random.default_rng(5)
    clean = clean_frames(truth)
    clean[1] *= 1.3
    one = camera(pace="live", photometric=True, non_negative=True)
    before = run(one, clean, 8, sigma=0.01, rng=rng)[-1]
    dim = clean - 0.1
    after = one.step(dim[0] + 0.01 * rng.standard_normal(SHAPE))
    assert after.settings["pace"] == "live"
    assert after.amplitude.image.min() == 0
    bright = before.amplitude.image > 0.3
    bright[:4], bright[-4:] = False, False
    gain = before.amplitude.predict.gain[0]
    fell = (after.amplitude.image - before.amplitude.image)[bright]
    assert abs(np.median(fell) * gain + 0.1) < 0.01


@pytest.mark.parametrize("factor", [3.0, 0.3])
@pytest.mark.parametrize("waves", [True, False])
@pytest.mark.parametrize("pace", ["auto", "refined"])
def test_a_step_of_the_light_leaves_the_picture_right(factor, waves, pace):
    """Frames of two brightnesses were mixed for a round: pictures were 50 to 230 % off."""
    for seed in (3, 4):
        truth = phasor_mosaic(seed, SHAPE).truth if waves else 0.2 + scene(seed).truth
        one, clean = camera(pace=pace, modulation_hz=15e6), clean_frames(truth)
        rng, sigma = np.random.default_rng(seed), 0.01 * np.abs(clean).mean()
        usual = error(run(one, clean, 6, sigma=sigma, rng=rng)[-1], truth)
        with pytest.warns(QualityWarning, match="the light changed") as told:
            after = run(one, factor * clean, 8, sigma=sigma, rng=rng, first=6)
        assert {str(text.message).partition(":")[0] for text in told} == {"the light changed"}
        noise = sigma / min(factor, 1)
        for found in after:
            assert found.settings["event"] is None
            assert error(found, factor * truth) < factor * (1.3 * usual + noise)


EXPOSURES = {
    "automatic": lambda rng, count: rng.uniform(0.7, 1.4, count),
    "flickers": lambda rng, count: 1 + 0.05 * rng.standard_normal(count),
    "ramp": lambda rng, count: 1.02 ** np.arange(count),
}


@pytest.mark.filterwarnings("ignore:the light changed")
@pytest.mark.parametrize("kind", EXPOSURES)
@pytest.mark.parametrize("waves", [True, False])
@pytest.mark.parametrize("pace", ["auto", "refined"])
def test_pictures_are_right_in_light_that_is_another_in_each_frame(kind, waves, pace):
    """Of an exposure of 0.7 to 1.4 they were five times as far off as at rest."""
    for seed in (5, 6, 7):
        truth = phasor_mosaic(seed, SHAPE).truth if waves else 0.2 + scene(seed).truth
        one, clean = camera(pace=pace, modulation_hz=15e6), clean_frames(truth)
        rng, sigma = np.random.default_rng(seed), 0.01 * np.abs(clean).mean()
        usual = error(run(one, clean, 6, sigma=sigma, rng=rng)[-1], truth)
        held = []
        for k, times in enumerate(EXPOSURES[kind](rng, 10), start=6):
            found = run(one, times * clean, 1, sigma=sigma, rng=rng, first=k)[0]
            assert found.settings["event"] is None
            assert error(found, times * truth) < times * 1.3 * usual + sigma
            off = np.abs(np.abs(found.amplitude.image) - times * np.abs(truth))
            held.append(np.mean((off < 2 * found.amplitude.std)[INNER]))
        assert np.mean(held) > 0.9


@pytest.mark.parametrize("copied", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_a_frame_that_comes_twice_is_no_loss(seed, copied):
    """Each was said to come after lost ones, and after the place before them."""
    truth, rng = scene(seed).truth, np.random.default_rng(seed)
    one, clean = camera(), clean_frames(truth)
    noisy = [clean[k % 4] + 0.01 * rng.standard_normal(SHAPE) for k in range(10 + seed)]
    for frame in noisy:
        one.step(frame)
    last = (len(noisy) - 1) % 4
    again = noisy[-1] if copied else clean[last] + 0.01 * rng.standard_normal(SHAPE)
    with pytest.warns(QualityWarning, match=f"a frame of place {last} came twice"):
        found = one.step(again)
    assert found.settings["event"] == "frame twice"
    after = run(one, clean, 9, sigma=0.01, rng=rng, first=last + 1)
    assert {found.settings["event"] for found in after} == {None}
    after_place = (last + 9) % 4
    with pytest.warns(QualityWarning, match=f"the one after place {after_place} is of"):
        found = run(one, clean, 1, sigma=0.01, rng=rng, first=after_place + 2)[0]
    assert found.settings["event"] == "frames lost"


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("waves", [True, False])
def test_frames_that_are_lost_in_other_light_keep_their_order(seed, waves):
    """They are told by the light of the place that they are of."""
    truth = phasor_mosaic(seed, SHAPE).truth if waves else 0.2 + scene(seed).truth
    one, clean = camera(modulation_hz=15e6), clean_frames(truth)
    rng, sigma = np.random.default_rng(seed), 0.02 * np.abs(clean).mean()
    for k in (*range(10), *range(11 + seed % 2, 24)):
        times = rng.uniform(0.8, 1.25)
        found = run(one, times * clean, 1, sigma=sigma, rng=rng, first=k)[0]
    assert one.frames[-1] == 23 % 4
    assert "contradiction" not in found.amplitude.notes


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
@pytest.mark.parametrize("waves", [True, False])
def test_light_that_goes_for_two_frames_leaves_nothing_behind(waves):
    """Frames of noise were multiplied by fifty, and each later one again with them."""
    for seed in (3, 4):
        truth = phasor_mosaic(seed, SHAPE).truth if waves else 0.2 + scene(seed).truth
        one, clean = camera(modulation_hz=15e6), clean_frames(truth)
        rng, sigma = np.random.default_rng(seed), 0.02 * np.abs(clean).mean()
        usual = error(run(one, clean, 12, sigma=sigma, rng=rng)[-1], truth)
        run(one, 0.02 * clean, 2, sigma=sigma, rng=rng)
        after = run(one, clean, 10, sigma=sigma, rng=rng, first=14)[-1]
        assert error(after, truth) < 1.3 * usual


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("waves", [True, False])
def test_light_of_frames_of_other_places(seed, waves):
    truth, rng = phasor_mosaic(seed, SHAPE).truth, np.random.default_rng(seed)
    clean = clean_frames(truth if waves else 0.2 + np.abs(truth))
    sigma = 0.02 * np.abs(clean).mean()
    noise = sigma * rng.standard_normal((2, *clean.shape))
    noisy = clean + (noise[0] + 1j * noise[1] if waves else noise[0])

    def burst(frames):
        return lensshift.Burst.from_arrays(frames, offset_px=SQUARE_PX, pitch_mm=1.0)

    times = rng.uniform(0.8, 1.25, 4)
    np.testing.assert_allclose(
        lights(burst(times[:, None, None] * noisy), 2), times[2] / times, rtol=0.01
    )
    other = noisy.copy()
    other[2, :, :8] *= 3
    assert np.all(lights(burst(noisy), 2) == 1)
    assert np.all(lights(burst(other), 2) == 1)
    if not waves:  # a level is no light
        assert np.all(lights(burst(noisy + np.array([0, 0, 1, 0])[:, None, None]), 2) == 1)


def lit(values):
    return Frame(values, None, np.ones(values.shape, bool), 0.0)


@pytest.mark.parametrize("factor", [0.05, 0.6, 1.5, 20.0])
@pytest.mark.parametrize("turn", [1.0, 1j])
def test_how_bright_a_frame_is(factor, turn):
    rng = np.random.default_rng(2)
    before = rng.uniform(0.5, 3, SHAPE) * np.exp(1j * rng.uniform(0, 3)) ** turn.imag
    after = factor * turn * before + 0.01 * rng.standard_normal(SHAPE)
    assert light_since(lit(after), lit(before)) == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_what_moved_are_no_other_light(seed):
    rng = np.random.default_rng(seed)
    before = rng.uniform(0.5, 3, SHAPE)
    for part, times in ((0, 1), (0.3, 4), (0.5, 0.2), (0.7, 1.5)):
        after = before + 0.05 * rng.standard_normal(SHAPE)
        after[:, : int(part * SHAPE[1])] *= times
        assert light_since(lit(after), lit(before)) == 1
    assert light_since(lit(rng.uniform(0.5, 3, SHAPE)), lit(before)) == 1
    assert light_since(lit(0 * before), lit(0 * before)) == 1
    flash = before.copy()
    flash[4, 5] += 1e6
    assert light_since(lit(flash), lit(before)) == light_since(lit(before), lit(flash)) == 1
    few = np.zeros(SHAPE, bool)
    few[3, 4:8] = True
    assert light_since(Frame(2 * before, None, few, 0.0), lit(before)) == 1


def test_light_that_jumps_and_sinks_back_slowly_is_where_it_was():
    """What is too little to be noticed from one frame to the next adds up to nothing."""
    truth, rng = 0.2 + scene(26).truth, np.random.default_rng(1)
    one, clean = camera(pace="live"), clean_frames(truth)
    light = np.r_[np.ones(8), np.geomspace(1.3, 1, 60), np.ones(4)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        for k, times in enumerate(light):
            found = one.step(times * clean[k % 4] + 0.02 * rng.standard_normal(SHAPE))
        found = one.picture(refined=True)
    assert error(found, truth) < 0.05


def test_phasors_without_distance_follow_by_a_factor_as_well():
    """Noise that is known leaves the choice of the channel to the user: amplitude, complex."""
    mosaic, rng = phasor_mosaic(3, SHAPE), np.random.default_rng(0)
    one = camera(pace="live", channel="amplitude", noise_sigma=mosaic.sigma)
    clean = clean_frames(mosaic.truth)
    before = run(one, clean, 8, sigma=mosaic.sigma, rng=rng)[-1]
    after = run(one, 1.2 * clean, 1, sigma=mosaic.sigma, rng=rng)[0]
    assert after.settings["pace"] == "live"
    ratio = (after.amplitude.image / before.amplitude.image)[INNER]
    assert np.iscomplexobj(ratio)
    assert abs(np.median(ratio.real) - 1.2) < 0.02


def test_a_frame_without_distances_is_computed():
    mosaic, valid = phasor_mosaic(3, SHAPE), np.ones(SHAPE, bool)
    one, clean = camera(pace="live", modulation_hz=15e6), clean_frames(mosaic.truth)
    far_m = np.mod(np.angle(clean), 2 * np.pi) / PER_M
    for k in range(6):
        found = one.step(Frame(np.abs(clean[k % 4]), far_m[k % 4], valid, float(k)))
    assert found.settings["pace"] == "live"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        found = one.step(Frame(np.abs(clean[2]), None, valid, 6.0))
    assert found.settings["pace"] == "refined"
    assert found.settings["event"] is None


def test_a_frame_without_distances_takes_them_away_and_says_so():
    mosaic, valid = phasor_mosaic(3, SHAPE), np.ones(SHAPE, bool)
    one, clean = camera(modulation_hz=15e6), clean_frames(mosaic.truth)
    far_m = np.mod(np.angle(clean), 2 * np.pi) / PER_M
    said, channels = [], []
    for k in range(9):
        with warnings.catch_warnings(record=True, action="always") as told:
            far = None if k == 4 else far_m[k % 4]
            found = one.step(Frame(np.abs(clean[k % 4]), far, valid, float(k)))
        said.append(any("a frame has no distances" in str(two.message) for two in told))
        channels.append("distance" in found.channels)
    assert said == [k == 4 for k in range(9)]
    assert channels == [not 4 <= k < 8 for k in range(9)]


def test_a_picture_asked_for_twice_is_the_same():
    one = camera(pace="live", modulation_hz=15e6, channel="phasor")
    clean, rng = clean_frames(phasor_mosaic(3, SHAPE).truth), np.random.default_rng(0)
    first = run(one, clean, 6, sigma=1e-3, rng=rng)[-1]
    np.testing.assert_array_equal(one.picture().amplitude.image, first.amplitude.image)


def test_distances_alone_are_held_against_the_picture_as_well():
    before, after = 5 + scene(31).truth, 5 + scene(32).truth
    one = lensshift.stream(
        lensshift.Burst.from_arrays(
            np.ones((4, *SHAPE)), np.ones((4, *SHAPE)), offset_px=SQUARE_PX, pitch_mm=1.0
        ),
        channel="distance", psf_sigma_px=SQUARE_PIXEL_PX, pace="live",
    )  # fmt: skip
    valid, rng = np.ones(SHAPE, bool), np.random.default_rng(3)
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        for truth in (before, after):
            for y in (*clean_frames(truth), *clean_frames(truth)):
                noisy = y + 0.01 * rng.standard_normal(SHAPE)
                found.append(one.step(Frame(np.ones(SHAPE), noisy, valid, 0.0)))
    assert found[7].settings["pace"] == "live"
    assert found[8].settings["event"] == "scene changed"
    assert np.sqrt(np.mean((found[-1].distance_m.image - after)[INNER] ** 2)) < 0.05


@pytest.mark.parametrize("seed", [9, 10, 11])  # frames of it seemed to be of another place
def test_something_that_moves_is_computed_anew_and_said(seed):
    truth, rng, one = scene(43).truth, np.random.default_rng(seed), camera(pace="live")
    run(one, clean_frames(truth), 8, sigma=0.01, rng=rng)
    moved = truth.copy()
    moved[10:22, 14:26] += 0.6
    with pytest.warns(QualityWarning, match="something moved"):
        found = run(one, clean_frames(moved), 1, sigma=0.01, rng=rng)[0]
    assert found.settings["pace"] == "refined"
    assert found.settings["event"] is None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        later = run(one, clean_frames(moved), 5, sigma=0.01, rng=rng, first=1)
    assert [one.settings["event"] for one in later] == [None] * 5
    assert later[-1].settings["pace"] == "live"
    assert error(later[3], moved) < 0.015  # a round after, with detail finer than pixels


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
@pytest.mark.parametrize("waves", [False, True])
def test_what_walks_is_shown_as_the_latest_frame_shows_it(waves):
    """Frames of four places of it were mixed: 3.5 and 5 times as far off as the latest one is."""
    ratios, after = [], []
    for seed in range(51, 54):
        rng, one = np.random.default_rng(seed), camera(modulation_hz=15e6)
        still = phasor_mosaic(seed, SHAPE).truth if waves else scene(seed).truth
        usual = run(one, clean_frames(still), 8, sigma=0.01, rng=rng)[-1]
        for number in range(8, 20):
            truth, left = still.copy(), 10 + number  # a hand, which has gone after eight frames
            if number < 16:
                truth[8:34, left : left + 9] = 1.1 * np.exp(-0.7j) if waves else 1.1
            place, latest = number % 4, camera(modulation_hz=15e6)
            frame = clean_frames(truth)[place] + 0.01 * rng.standard_normal(SHAPE)
            found = one.step(frame, place=place)
            if number < 16:
                alone = error(latest.step(frame, place=place), truth)
                ratios.append(error(found, truth) / alone)
        after.append(error(found, still) / error(usual, still))
    assert np.median(ratios) < 1.4
    assert max(after) < 1.3


def test_a_surface_that_only_comes_nearer_is_computed_anew():
    mosaic, rng = phasor_mosaic(4, SHAPE), np.random.default_rng(9)
    nearer = mosaic.truth.copy()
    nearer[10:22, 14:26] *= np.exp(-0.5j)
    one = camera(pace="live", modulation_hz=15e6, channel="phasor")
    rests = run(one, clean_frames(mosaic.truth), 8, sigma=mosaic.sigma, rng=rng)[-1]
    assert rests.settings["pace"] == "live"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        found = run(one, clean_frames(nearer), 4, sigma=mosaic.sigma, rng=rng)
    assert found[0].settings["pace"] == "refined"
    off_rad = np.angle(np.exp(1j * PER_M * found[-1].distance_m.image) / nearer)
    turned = np.median((off_rad - np.median(off_rad))[12:20, 16:24])
    assert abs(turned) < 0.05


def test_frames_that_say_where_they_are_from_may_come_in_any_order():
    truth, rng = scene(42).truth, np.random.default_rng(7)
    clean, one = clean_frames(truth), camera()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for place in (0, 2, 1, 3, 3, 0, 2):
            noisy = clean[place] + 0.02 * rng.standard_normal(SHAPE)
            found = one.step(noisy, place=place)
    assert one.frames[-1] == 2
    assert found.settings["places"] == [0, 1, 2, 3]


def test_frames_with_holes_and_distances_and_a_burst_as_plan():
    clean, rng = clean_frames(scene(51).truth), np.random.default_rng(9)
    clean += 0.1 - clean.min()
    noise = 0.01 * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    amplitude, distance_m = np.abs(clean + noise), 3 + np.angle(clean + noise) / PER_M
    template = lensshift.Burst.from_arrays(
        amplitude, distance_m, offset_px=SQUARE_PX, pitch_mm=0.1, modulation_hz=15e6
    )
    one, valid = lensshift.stream(template), np.ones(SHAPE, bool)
    valid[3, 4] = False
    for k in (0, 1, 2, 3, 0):
        found = one.step(Frame(amplitude[k], distance_m[k], valid, float(k)))
    assert found.distance_m is not None
    error_m = found.distance_m.image[INNER] - 3
    assert np.sqrt(np.mean(error_m**2)) < 0.5 * np.std(distance_m)


def known(expected, noise):
    """Return a picture that predicts that frame at its only place, as the last one there was."""
    predict = FramePredictor(
        expected, 1, GaussianBlur(0.0), np.zeros((1, 2)), np.ones(1), np.zeros(1)
    )
    light = Estimate(expected, noise_sigma=noise, predict=predict)
    found = Reconstruction(light, None, Grid(expected.shape, (1.0, 1.0)), 1, "auto")
    frame = Frame(expected, None, np.ones(expected.shape, bool), 0.0)
    return Known(Followed(found, found), {2: frame})


@pytest.mark.parametrize("shape", [(1, 9), (14, 2), (3, 9)])
def test_narrow_frames_count_as_a_whole(shape):
    """Of a chequerboard; a level would be light that flickers."""
    one, valid = known(np.ones(shape), 0.02), np.ones(shape, bool)
    board = (-1.0) ** np.add.outer(*map(np.arange, shape))
    for size, share in ((0.0, 0.0), (0.5, 1.0)):
        _, share_seen = one.against(Frame(1 + size * board, None, valid, 0.0), 2)
        assert share_seen == share
    _, share_seen = one.against(Frame(np.full(shape, 1.5), None, valid, 0.0), 2)
    assert share_seen == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_frame_of_few_pixels_makes_no_other_scene_of_the_next(seed):
    """What it tells of the change since was held against all of the next frame of its place."""
    rng, shape = np.random.default_rng(seed), (12, 16)
    light = rng.uniform(0.1, 5, shape)
    one = known(light, 0.02)
    few = np.zeros(shape, bool)
    few[rng.integers(2, 10), rng.integers(2, 14, 2)] = True
    one.frames[2] = Frame(light + 0.02 * rng.standard_normal(shape), None, few, 0.0)
    for noise in 0.02 * rng.standard_normal((5, *shape)):
        next_one = Frame(1.5 * light + noise, None, np.ones(shape, bool), 1.0)
        assert one.against(next_one, 2) == ({}, 0.5)  # computed anew, and no other scene


@pytest.mark.parametrize(("shape", "inside"), [((3, 14), 3), ((9, 12), 6)])
@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_one_pixel_contradicts_in_all_around_but_the_border(shape, inside, slope):
    """Beyond four variances in the mean of nine; along a slope some of a shift is allowed."""
    noise = 0.02
    expected = slope * np.arange(shape[1]) + np.ones(shape)
    one, valid = known(expected, noise), np.ones(shape, bool)
    least = 6 * np.hypot(noise, ALLOWED_SHIFT_PX * slope)
    for size, contradict in ((0.95 * least, 0), (1.2 * least, inside)):
        y = expected.copy()
        y[1, 6] += size
        y[0, 9] -= 0.5 * least
        _, share_seen = one.against(Frame(y, None, valid, 0.0), 2)
        assert share_seen == pytest.approx(contradict / ((shape[0] - 2) * (shape[1] - 2)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lensshift.stream([[0, 0, 0]], shape=SHAPE), "plan"),
        (lambda: lensshift.stream(SQUARE_PX), "shape"),
        (lambda: camera(pace="hurry"), "pace"),
        (lambda: camera(method="magic"), "magic"),
        (lambda: camera().step(np.ones((3, 4))), r"\(21, 26\)"),
        (lambda: camera().step(np.ones(5)), "row col"),
        (lambda: camera().step(np.full(SHAPE, "dark")), "numbers"),
        (lambda: camera().step(np.ones(SHAPE), place=4), "place"),
    ],
)
def test_what_cannot_be_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("waves", [True, False])
def test_amplitudes_are_no_phasors_of_phase_zero(waves):
    """Their distances came out as 0, with an error of centimetres."""
    light = np.random.default_rng(3).uniform(1, 2, (4, 9, 12))
    phasors = light * np.exp(2j)
    first, second = (phasors, light) if waves else (light, phasors)
    camera = lensshift.stream(SQUARE_PX, shape=(9, 12), modulation_hz=20e6)
    for frame in first[:2]:
        camera.take(frame)
    with pytest.raises(ValueError, match=r"as the frames before, got (amplitudes|phasors)"):
        camera.take(second[2])
    assert camera.frames == (0, 1)  # and it goes on
    camera.take(first[2])
    assert camera.frames == (0, 1, 2)


@pytest.mark.parametrize(
    ("told", "count"), [({}, 1), ({"channel": "amplitude"}, 0), ({"modulation_hz": 20e6}, 0)]
)
def test_phasors_whose_frequency_nobody_told_are_named_once(told, count):
    """From Python they stayed complex, without distances, and without a word."""
    z = np.random.default_rng(5).uniform(1, 2, (4, 9, 12)) * np.exp(1j)
    hz = {"modulation_hz": told.get("modulation_hz")}
    burst = lensshift.Burst.from_arrays(z, offset_px=SQUARE_PX, pitch_mm=1.0, **hz)
    rest = {name: value for name, value in told.items() if name not in hz}
    one = lensshift.stream(SQUARE_PX, shape=(9, 12), **told)
    calls = (lambda: lensshift.reconstruct(burst, **rest), lambda: [one.step(y) for y in z])
    for call in calls:
        with warnings.catch_warnings(record=True, action="always") as said:
            call()
        assert sum("modulation_hz=20e6" in str(text.message) for text in said) == count


def test_phasors_of_several_frequencies_are_refused():
    camera = lensshift.stream(SQUARE_PX, shape=(9, 12), modulation_hz=(100e6, 20e6))
    camera.take(np.ones((9, 12)))  # amplitudes of it are what they are
    with pytest.raises(ValueError, match="phasors of one modulation frequency, got 2"):
        camera.take(np.ones((9, 12)) * 1j)


def test_an_interrupted_step_leaves_a_stream_that_goes_on():
    truth, rng = scene(61).truth, np.random.default_rng(8)
    clean, seen = clean_frames(truth), []

    def stop(number, misfit):
        seen.append(number)
        if len(seen) == 14:
            raise KeyboardInterrupt

    one = camera(on_iteration=stop)
    with pytest.raises(KeyboardInterrupt):
        run(one, clean, 12, sigma=0.02, rng=rng)
    found = run(one, clean, 8, sigma=0.02, rng=rng, place=True)
    assert error(found[-1], truth) < 0.05
