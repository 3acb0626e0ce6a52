"""Frames that turn, grow and shear: found, named, stored and allowed for."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from lensshift import Burst, load_burst, load_image_stack, reconstruct, register, save_burst
from lensshift.core.errors import DataError, QualityWarning
from lensshift.io.export import export_burst
from lensshift.reconstruction.glance import glance
from lensshift.reconstruction.shift_check import doubtful_shifts
from lensshift.registration import picture
from lensshift.registration.affine import (
    LEAST_CORNER_PX,
    affine_motion,
    corner_px,
    turning,
    turns_of,
)

FINE = 6
SHAPE = (29, 36)
Frames = NDArray[np.float64]


def scene(row: Frames, col: Frames) -> Frames:
    """A random field of waves, and three dark squares on it."""
    rng = np.random.default_rng(8)
    waves = rng.normal(scale=0.12, size=(20, 2)), rng.uniform(0, 2 * np.pi, 20)
    seen = sum(
        np.cos(2 * np.pi * (a * row + b * col) + p) for (a, b), p in zip(*waves, strict=True)
    )
    for top, left, side in ((3, 4, 8), (15, 20, 9), (6, 26, 5)):
        dark = (abs(row - top - side / 2) < side / 2) & (abs(col - left - side / 2) < side / 2)
        seen = np.where(dark, -4.0, seen)
    return np.asarray(seen)


def taken(offset_px: Frames, affine: Frames, noise: float, seed: int) -> Frames:
    """Return what square pixels see whose places are moved by offset + affine (u - middle)."""
    inside = (np.arange(FINE) + 0.5) / FINE - 0.5
    row, col = ((np.arange(size)[:, None] + inside).ravel() for size in SHAPE)
    down, right = row[:, None] - (SHAPE[0] - 1) / 2, col - (SHAPE[1] - 1) / 2
    seen = [
        scene(
            row[:, None] - d[0] - m[0, 0] * down - m[0, 1] * right,
            col - d[1] - m[1, 0] * down - m[1, 1] * right,
        )
        for d, m in zip(offset_px, affine, strict=True)
    ]
    frames = np.array(seen).reshape(-1, SHAPE[0], FINE, SHAPE[1], FINE).mean(axis=(2, 4))
    return frames + np.random.default_rng(seed).normal(scale=noise, size=frames.shape)


def motion(count: int, seed: int, size: float) -> tuple[Frames, Frames]:
    """Return offsets and matrices, the first none; they move corners by up to some `size` px."""
    rng = np.random.default_rng(seed)
    offset_px = rng.uniform(-0.6, 0.6, (count, 2))
    affine = rng.uniform(-1, 1, (count, 2, 2)) * size / 32
    affine[:, 1, 0] -= affine[:, 0, 1]  # more turn than shear
    return offset_px - offset_px[0], affine - affine[0]


@pytest.mark.parametrize(("size", "seed"), [(0.3, 1), (1.0, 2), (3.0, 3)])
def test_shift_turn_growth_and_shear_are_found(size: float, seed: int) -> None:
    offset_px, affine = motion(6, seed, size)
    frames = taken(offset_px, affine, 0.05, seed)
    start_px = offset_px + np.random.default_rng(seed).normal(scale=0.1, size=offset_px.shape)
    found = affine_motion(frames, np.ones(frames.shape, np.bool_), start_px - start_px[0])
    assert found.settled
    assert corner_px(found.affine - affine, SHAPE) < 0.04
    np.testing.assert_allclose(found.offset_px, offset_px, atol=0.02)
    np.testing.assert_array_equal(found.affine[0], 0.0)


def test_of_a_turn_its_angle_and_of_growth_its_part_is_told() -> None:
    turn, growth = np.deg2rad(1.5), 0.02
    turned = (1 + growth) * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    degrees, size = turns_of(np.array([np.zeros((2, 2)), turned - np.eye(2)]))
    np.testing.assert_allclose(degrees, [0, 1.5 * (1 + growth)], rtol=1e-3)
    np.testing.assert_allclose(size, [0, growth], atol=4e-4)


def test_large_frames_come_to_it_from_coarse_ones() -> None:
    """A turn by 3 degrees moves a corner of 130 x 140 pixels by 7 px."""
    rng = np.random.default_rng(4)
    row, col = np.mgrid[:130, :140] - np.array([64.5, 69.5])[:, None, None]
    waves = rng.normal(scale=0.06, size=(40, 2)), rng.uniform(0, 2 * np.pi, 40)
    affine = np.zeros((4, 2, 2))
    affine[1:, 0, 1], affine[1:, 1, 0] = (-0.05, 0.03, 0.01), (0.05, -0.03, -0.01)
    frames = []
    for m in affine:
        down, right = row - m[0, 0] * row - m[0, 1] * col, col - m[1, 0] * row - m[1, 1] * col
        frames.append(
            sum(
                np.cos(2 * np.pi * (a * down + b * right) + p)
                for (a, b), p in zip(*waves, strict=True)
            )
        )
    y = np.array(frames) + rng.normal(scale=0.05, size=(4, 130, 140))
    found = affine_motion(y, np.ones(y.shape, np.bool_), np.zeros((4, 2)))
    assert corner_px(found.affine - affine, y.shape[1:]) < 0.05


@pytest.mark.parametrize("seed", [5, *(pytest.param(n, marks=pytest.mark.slow) for n in (6, 7))])
def test_frames_that_turn_are_named_and_others_are_not(seed: int) -> None:
    offset_px, affine = motion(6, seed, 0.6)
    turned = Burst.from_arrays(taken(offset_px, affine, 0.05, seed))
    with pytest.warns(QualityWarning, match=r"degrees in turn.*motion=\"shift\""):
        found = register(turned)
    assert found.affine is not None
    assert corner_px(found.affine - affine, SHAPE) < 0.04
    still = taken(offset_px, 0 * affine, 0.05, seed)
    assert turning(still, np.ones(still.shape, np.bool_), offset_px) is None
    with warnings.catch_warnings():
        warnings.simplefilter("error", QualityWarning)
        assert register(Burst.from_arrays(still)).affine is None
    with pytest.warns(QualityWarning, match="parts of the frames disagree"):
        assert register(turned, motion="shift").affine is None


def square(top: Frames, left: Frames, side: float) -> Frames:
    """Return which share of each pixel a square covers [frame row col]."""
    along = []
    for start, size in zip((top, left), SHAPE, strict=True):
        pixel = np.arange(size) - start[:, None]
        along.append(np.clip(np.minimum(pixel + 1, side) - np.maximum(pixel, 0), 0, 1))
    return along[0][:, :, None] * along[1][:, None, :]


@pytest.mark.parametrize("seed", [3, 10, 40])
def test_noise_turns_no_frame(seed: int) -> None:
    """Where frames tell nothing of turns the search follows the noise, on and on."""
    offset_px, _ = motion(9, seed, 0.0)
    rng = np.random.default_rng(seed)
    still = square(4.3 + offset_px[:, 0], 5.2 + offset_px[:, 1], 9.0)
    other = square(18.1 + offset_px[:, 0], 22.6 + offset_px[:, 1], 7.0)
    frames = still + other + rng.normal(scale=0.2, size=still.shape)
    start_px = offset_px + rng.normal(scale=0.05, size=offset_px.shape)
    assert turning(frames, np.ones(frames.shape, np.bool_), start_px - start_px[0]) is None


@pytest.mark.parametrize("seed", [3, 5])
def test_noise_is_not_searched_for_turns(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It seems to turn corners by 0.1 px and more, and led a search through all its rounds."""
    offset_px, _ = motion(4, seed, 0.0)
    frames = taken(offset_px, np.zeros((4, 2, 2)), 5.0, seed)
    valid = np.ones(frames.shape, np.bool_)
    first, _ = picture.step_from(frames, valid, offset_px, terms=3)
    assert np.abs((first - first[0])[..., 1:]).sum(axis=2).max() > LEAST_CORNER_PX
    monkeypatch.delattr(picture, "alternate")
    assert turning(frames, valid, offset_px) is None


@pytest.mark.parametrize("seed", [12, 13])
def test_a_square_that_moves_beside_one_that_does_not_turns_no_frame(seed: int) -> None:
    """Six numbers a frame would explain both, but only the moved one gains by it."""
    offset_px, _ = motion(9, seed, 0.0)
    way_px = np.linspace(0, 0.8, 9)
    still = square(4.3 + offset_px[:, 0], 5.2 + offset_px[:, 1], 9.0)
    moved = square(18.1 + offset_px[:, 0], 22.6 + offset_px[:, 1] + way_px, 7.0)
    noise = np.random.default_rng(seed).normal(scale=0.01, size=still.shape)
    frames = 1 + still + moved + noise
    assert turning(frames, np.ones(frames.shape, np.bool_), offset_px) is None


def test_the_picture_and_frames_left_out_follow_the_motion() -> None:
    offset_px, affine = motion(9, 9, 1.0)
    burst = Burst.from_arrays(taken(offset_px, affine, 0.05, 9), offset_px=offset_px)
    found = register(burst, motion="affine")
    assert found.affine is not None
    assert corner_px(found.affine - affine, SHAPE) < 0.04
    errors = []
    for one in (found, burst):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", QualityWarning)
            estimate = reconstruct(one, frames=[0, 2, 4, 6, 8], std=False).amplitude
        assert estimate is not None
        rest = np.stack([estimate.predict(k) - burst.amplitude[k] for k in (1, 3, 5, 7)])
        errors.append(np.std(rest[:, 4:-4, 4:-4]))
    assert errors[0] < 0.5 * errors[1]


def test_frames_that_turn_as_told_are_not_doubted() -> None:
    """The part that is looked at lies beside the middle: shifts by a turn grow with their unit."""
    rng = np.random.default_rng(4)
    scene = 20 * ndimage.gaussian_filter(rng.normal(size=(60, 72)), 1.0)
    angle_deg = np.array([0, 0.6, -0.8, 0.4, -0.3, 0.7])
    turned = [ndimage.rotate(scene, one, reshape=False, order=3) for one in angle_deg]
    frames = np.array(turned)[:, 6:-6, 6:-6] + rng.normal(scale=0.05, size=(6, 48, 60))
    affine = np.deg2rad(angle_deg)[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]])
    field = Burst.from_arrays(frames, offset_px=np.zeros((6, 2)), affine=affine).shift_field
    assert field is not None
    valid = np.ones(frames.shape, bool)
    assert doubtful_shifts(glance(frames, field.offset_px, valid), 2) is None
    doubt = doubtful_shifts(glance(frames, np.zeros((6, 2)), valid), 2)
    assert doubt is not None
    assert doubt.mistake in ("frames that turn", "shifts that were not told")


def test_it_is_stored_and_goes_with_its_frames(tmp_path: Path) -> None:
    offset_px, affine = motion(5, 10, 1.0)
    burst = Burst.from_arrays(
        taken(offset_px, affine, 0.05, 10), offset_px=offset_px, affine=affine
    )
    save_burst(burst, tmp_path / "turned.nc")
    export_burst(burst, tmp_path / "turned.npz")
    for again in (load_burst(tmp_path / "turned.nc"), load_image_stack(tmp_path / "turned.npz")):
        np.testing.assert_array_equal(again.affine, affine)
    part = burst.select([3, 1])
    assert part.shift_field is not None
    assert burst.shift_field is not None
    np.testing.assert_array_equal(part.shift_field.offset_px, burst.shift_field.offset_px[[3, 1]])
    middle = burst.shift_field.offset_px[:, 14, 17:19].mean(axis=1)
    np.testing.assert_allclose(middle, offset_px, atol=1e-12)


def test_what_cannot_be_is_refused() -> None:
    offset_px, affine = motion(5, 11, 0.5)
    burst = Burst.from_arrays(taken(offset_px, affine, 0.05, 11), offset_px=offset_px)
    with pytest.raises(ValueError, match="at least 4 frames"):
        register(burst.select([0, 1, 2]), motion="affine")
    with pytest.raises(ValueError, match='method "auto" with motion "affine"'):
        register(burst, method="phase", motion="affine")
    with pytest.raises(ValueError, match="motion among auto, shift, affine"):
        register(burst, motion="turn")  # type: ignore[arg-type]
    with pytest.raises(DataError, match="affine"):
        Burst.from_arrays(burst.amplitude, offset_px=offset_px, affine=affine[:3])
