"""Stray light: the closed form, its measurement, and pictures without it."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from lensshift import (
    Burst,
    DataError,
    StrayLight,
    load_reconstruction,
    measure_stray_light,
    reconstruct,
    save_reconstruction,
    stream,
)
from lensshift.core.units import distance_to_phase

SHAPE, FINE, MODULATION_HZ = (23, 34), 8, 20e6
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)])
SHARE = 0.02


def gaussian_of_mirrored(frame, sigma_px):
    """Blur with weights that are summed over mirror images, without any transform."""
    found = frame
    for axis, n in enumerate(frame.shape):
        image = np.arange(-6 * n, 7 * n)
        weight = np.exp(-0.5 * ((np.arange(n)[:, None] - image) / sigma_px) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        back = np.mod(image, 2 * n)
        matrix = np.zeros((n, n))
        np.add.at(matrix.T, np.where(back < n, back, 2 * n - 1 - back), weight.T)
        found = np.moveaxis(np.tensordot(matrix, found, (1, axis)), 0, axis)
    return found


@given(
    st.integers(0, 2**31), st.floats(0.0, 0.4), st.floats(1.0, 20.0), st.booleans()
)  # fmt: skip
def test_what_is_added_is_removed_and_levels_stay(seed, share, sigma_px, waves):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((2, 7, 12)) + (1j * rng.standard_normal((2, 7, 12)) if waves else 0)
    stray = StrayLight(share, sigma_px)
    assert np.allclose(stray.removed(stray.added(x)), x)
    assert stray.added(x).sum() == pytest.approx(x.sum())
    assert np.allclose(stray.removed(np.full((3, 5, 9), 2.5)), 2.5)


@pytest.mark.parametrize("sigma_px", [1.5, 4.0, 11.0])
def test_the_spread_is_a_gaussian_of_the_mirrored_image(sigma_px):
    x = np.random.default_rng(3).random((9, 14))
    assert np.allclose(
        StrayLight(0.1, sigma_px).spread(x), gaussian_of_mirrored(x, sigma_px), atol=2e-4
    )


def far_spread(frames):
    """Return frames some of whose light is spread as no Gaussian is, and lost beyond the sensor."""
    rows, cols = (3 * n for n in frames.shape[1:])
    row, col = np.indices((rows, cols))
    away = np.hypot(np.minimum(row, rows - row), np.minimum(col, cols - col))
    kernel = np.exp(-away / 8.0)
    padded = np.zeros((len(frames), rows, cols), complex)
    padded[:, : frames.shape[1], : frames.shape[2]] = frames
    spread = np.fft.ifft2(np.fft.fft2(padded) * np.fft.fft2(kernel / kernel.sum()))
    return (1 - SHARE) * frames + SHARE * spread[:, : frames.shape[1], : frames.shape[2]]


def room(seed, *, card, noise_seed):
    """Return a burst of dark and bright boxes before a wall, true distances, and what is flat."""
    rng = np.random.default_rng(seed)
    rows, cols = ((n + 2) * FINE for n in SHAPE)
    y, x = np.mgrid[:rows, :cols] / FINE
    far_m, light = 4.0 + 0.01 * x, np.full((rows, cols), 0.25)
    for _ in range(5):
        at, half = rng.uniform(2, list(SHAPE)), rng.uniform(2, 6, 2)
        box = (np.abs(y - at[0]) < half[0]) & (np.abs(x - at[1]) < half[1])
        far_m[box], light[box] = rng.uniform(2.5, 4.0), np.exp(rng.uniform(np.log(0.05), 0.0))
    if card:
        box = (np.abs(y - SHAPE[0] / 2) < 3.5) & (np.abs(x - SHAPE[1] / 2) < 4)
        far_m[box], light[box] = 1.5, 2.0
    fine = light * np.exp(1j * distance_to_phase(far_m, MODULATION_HZ))
    rng = np.random.default_rng((seed, noise_seed))
    moved_px = SQUARE_PX + 0.02 * rng.standard_normal(SQUARE_PX.shape)
    frames = np.stack([
        np.roll(fine, np.rint(offset * FINE).astype(int), (0, 1))
        .reshape(SHAPE[0] + 2, FINE, SHAPE[1] + 2, FINE).mean(axis=(1, 3))
        for offset in moved_px
    ])  # fmt: skip
    frames = far_spread(frames)[:, 1:-1, 1:-1]
    noise = rng.standard_normal(frames.shape) + 1j * rng.standard_normal(frames.shape)
    frames = frames + np.median(np.abs(frames)) / 50 * noise
    inner = far_m[FINE:-FINE, FINE:-FINE]
    seen = inner.reshape(2 * SHAPE[0], FINE // 2, 2 * SHAPE[1], FINE // 2)
    mixed = np.ptp(seen, axis=(1, 3)) > 0.05
    flat = ~binary_dilation(mixed, iterations=2)
    flat[[0, -1]] = flat[:, [0, -1]] = False
    made = Burst.from_arrays(frames, offset_px=SQUARE_PX, pitch_mm=0.1, modulation_hz=MODULATION_HZ)
    return made, seen.mean(axis=(1, 3)), flat


def told_by(burst, stray):
    return Burst.from_arrays(
        burst.amplitude, offset_px=SQUARE_PX, pitch_mm=0.1, modulation_hz=MODULATION_HZ,
        meta={"stray_light": stray.table},
    )  # fmt: skip


def test_a_share_that_a_card_measured_gives_dark_surfaces_their_distance():
    card, empty = (room(40, card=one, noise_seed=int(one))[0] for one in (True, False))
    measured = measure_stray_light(card, empty)
    held, off_m = [], []
    for seed in range(4):
        burst, true_m, flat = room(seed, card=True, noise_seed=2)
        both = [reconstruct(one).distance_m for one in (burst, told_by(burst, measured))]
        wrong = [(one.image - true_m)[flat] for one in both]
        held.append([
            np.mean(np.abs(e) < 2 * one.std[flat]) for e, one in zip(wrong, both, strict=True)
        ])  # fmt: skip
        off_m.append([np.median(np.abs(e)) for e in wrong])
    before, after = np.mean(held, axis=0)
    assert before < 0.9 < 0.93 < after
    assert np.mean(off_m, axis=0)[1] < 0.7 * np.mean(off_m, axis=0)[0]


@pytest.mark.parametrize("seed", [0, 4])
def test_distances_on_their_own_lose_it_as_phasors_do(seed):
    burst, true_m, flat = room(seed, card=True, noise_seed=2)
    far_m = np.mod(np.angle(burst.amplitude), 2 * np.pi) / distance_to_phase(1.0, MODULATION_HZ)
    stray = {"stray_light": StrayLight(0.015, 7.0, 0.001).table}
    off_m = []
    for meta in ({}, stray):
        made = Burst.from_arrays(
            np.abs(burst.amplitude), far_m, offset_px=SQUARE_PX, pitch_mm=0.1,
            modulation_hz=MODULATION_HZ, meta=meta,
        )  # fmt: skip
        far = reconstruct(made, channel="distance").distance_m.image
        off_m.append(np.median(np.abs(far - true_m)[flat]))
    assert off_m[1] < 0.8 * off_m[0]


def gaussian_world(seed, share, sigma_px, *, card):
    rng = np.random.default_rng((seed, card))
    x = np.full((4, *SHAPE), 0.3 + 0.1j)
    x[:, 8:12, 14:20] += card * (2.0 - 1.5j)
    y = (1 - share) * x
    y += share * np.stack([gaussian_of_mirrored(one, sigma_px) for one in x])
    y += 1e-3 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    return Burst.from_arrays(y, offset_px=SQUARE_PX, pitch_mm=0.1, modulation_hz=MODULATION_HZ)


@pytest.mark.parametrize(("share", "sigma_px"), [(0.01, 5.0), (0.03, 8.0), (0.1, 6.0)])
def test_the_measured_share_is_off_by_what_it_says(share, sigma_px):
    off = []
    for seed in range(12):
        both = (gaussian_world(seed, share, sigma_px, card=one) for one in (True, False))
        found = measure_stray_light(*both)
        assert found.sigma_px == pytest.approx(sigma_px, rel=0.15)
        off.append((found.share - share) / found.share_std)
    assert found.share_std < 0.1 * share
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 2.0


def test_measuring_refuses_what_is_no_object():
    empty = gaussian_world(0, 0.01, 5.0, card=False)
    with pytest.raises(DataError, match="small"):
        measure_stray_light(empty, empty)
    with pytest.raises(DataError, match="small"):
        measure_stray_light(gaussian_world(1, 0.01, 5.0, card=False), empty)
    with pytest.raises(DataError, match="without"):
        measure_stray_light(empty, empty.select([0, 1]))


def test_predicted_frames_hold_the_stray_light_and_so_do_files(tmp_path):
    burst = told_by(room(3, card=True, noise_seed=0)[0], StrayLight(0.03, 6.0, 0.003))
    found = reconstruct(burst)
    bare = reconstruct(burst, stray_light=StrayLight(0.0, 6.0))
    save_reconstruction(found, tmp_path / "found.nc")
    loaded = load_reconstruction(tmp_path / "found.nc")
    for one in (loaded, pickle.loads(pickle.dumps(found))):
        for channel in ("amplitude", "distance"):
            assert np.allclose(one[channel].predict(1), found[channel].predict(1), rtol=1e-5)
    off = [
        np.sqrt(np.mean((one.amplitude.predict(1) - np.abs(burst.amplitude[1])) ** 2))
        for one in (found, bare)
    ]
    assert off[0] < 1.02 * off[1]  # the same frames are seen of both pictures
    shifted = np.abs(found.distance_m.image - bare.distance_m.image)
    assert np.median(shifted) > 1e-3
    assert found.settings["stray_light"] == burst.meta["stray_light"]


def test_a_stream_follows_frames_with_their_stray_light():
    burst = told_by(room(5, card=True, noise_seed=0)[0], StrayLight(0.03, 6.0, 0.003))
    live = stream(burst)
    for n in range(12):
        one = live.step(burst.amplitude[n % 4])
    whole = reconstruct(burst)
    apart = np.abs(one.distance_m.image - whole.distance_m.image)
    assert np.mean(apart < whole.distance_m.std) > 0.97


def test_stray_light_that_is_none_is_refused():
    for told in ({"share": 0.7, "sigma_px": 3.0}, {"share": 0.1}, {"shares": 1}, 0.01, "much"):
        made = Burst.from_arrays(
            np.ones((4, *SHAPE)), offset_px=SQUARE_PX, pitch_mm=0.1, meta={"stray_light": told}
        )
        with pytest.raises(DataError, match="stray_light"):
            reconstruct(made)
    with pytest.raises(ValueError, match="sigma_px"):
        StrayLight(0.01, float("nan"))


def test_numbers_are_no_stray_light() -> None:
    burst = Burst.from_arrays(np.ones((4, 8, 9)), offset_px=np.zeros((4, 2)))
    with pytest.raises(TypeError, match=r"expected StrayLight\(share, sigma_px\), got \(0.02"):
        reconstruct(burst, stray_light=(0.02, 4.0, 0.002))  # type: ignore[arg-type]
