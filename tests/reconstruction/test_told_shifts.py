"""Told shifts that are off are mended and named; those that are right, or exact, stay."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pixel_camera import SQUARE_PX, Array, interior_psnr, make_burst, photograph, truth

import lensshift.registration.told
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, ShiftField
from lensshift.reconstruction.reconstruct import reconstruct

SHAPE, SIGMA = (27, 34), 0.01
NINE_PX = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]) / 3


def _cards(row: Array, col: Array) -> Array:
    """Turned cards of several sizes, one before the other."""
    rng = np.random.default_rng(7)
    found = np.full(np.broadcast(row, col).shape, 0.3)
    for _ in range(25):
        y, x, half, angle = rng.uniform((0, 0, 1.5, 0), (27, 34, 5, np.pi))
        down, right = row - y, col - x
        across = down * np.cos(angle) + right * np.sin(angle)
        along = right * np.cos(angle) - down * np.sin(angle)
        found = np.where((np.abs(across) < half) & (np.abs(along) < half), rng.random(), found)
    return found


def _burst(planned_px: Array, error_px: float, seed: int) -> Burst:
    """Return frames that lie beside where they are told to, under noise."""
    rng = np.random.default_rng(seed)
    true_px = planned_px + error_px * rng.standard_normal(planned_px.shape)
    true_px += (planned_px - true_px).mean(axis=0)
    frames = photograph(_cards, SHAPE, true_px)
    seen = frames + SIGMA * rng.standard_normal(frames.shape)
    return make_burst(seen, planned_px, meta={"true_px": true_px.tolist()})


def _exact(burst: Burst) -> Burst:
    return replace(burst, offset_sigma_px=np.zeros_like(burst.offset_px))


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("planned_px", [SQUARE_PX, NINE_PX], ids=["square", "nine"])
def test_shifts_that_are_off_by_a_tenth_of_a_pixel_are_named_and_mended(
    planned_px: Array, seed: int
) -> None:
    burst = _burst(planned_px, 0.1, seed)
    with pytest.warns(QualityWarning, match=r"offset_px is off by 0\.\d+ px \(rms; frame \d by"):
        found = reconstruct(burst, psf_sigma_px=0.3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        believed = reconstruct(_exact(burst), psf_sigma_px=0.3)
    wanted = truth(_cards, SHAPE, 2)
    gained_db = interior_psnr(found.amplitude.image, wanted) - interior_psnr(
        believed.amplitude.image, wanted
    )
    assert gained_db > 0.2
    assert 0.05 < found.settings["offset_error_px"] < 0.2
    moved_px = np.array(found.settings["corrected_offset_px"])
    np.testing.assert_allclose(moved_px.mean(axis=0), planned_px.mean(axis=0), atol=1e-9)
    true_px = np.array(burst.meta["true_px"])
    assert np.std(moved_px - true_px) < 0.2 * np.std(planned_px - true_px)
    # A frame is predicted where it lies, not where it was told to.
    rest = [np.std((burst.amplitude[0] - one.amplitude.predict(0))[4:-4, 4:-4]) for one in
            (found, believed)]  # fmt: skip
    assert rest[0] < rest[1]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("planned_px", [SQUARE_PX, NINE_PX], ids=["square", "nine"])
@pytest.mark.filterwarnings("error::lensshift.QualityWarning")
def test_right_shifts_stay(planned_px: Array, seed: int) -> None:
    burst = _burst(planned_px, 0.0, seed)
    found = reconstruct(burst, psf_sigma_px=0.3)
    assert "corrected_offset_px" not in found.settings
    believed = reconstruct(_exact(burst), psf_sigma_px=0.3)
    np.testing.assert_array_equal(found.amplitude.image, believed.amplitude.image)


def test_shifts_that_the_frames_told_or_that_are_exact_are_not_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def asked(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(lensshift.registration.told, "corrected_shifts", asked)
    burst = _burst(SQUARE_PX, 0.05, 3)
    with pytest.raises(AssertionError):
        reconstruct(burst)
    field = ShiftField(np.broadcast_to(SQUARE_PX[:, None, None], (4, *SHAPE, 2)))
    for one, settings in (
        (_exact(burst), {}),
        (replace(burst, offset_source="registered"), {}),
        (burst, {"shift_field": field}),
        (burst, {"method": "tikhonov"}),
    ):
        assert "corrected_offset_px" not in reconstruct(one, **settings).settings


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_part_that_moves_is_not_a_shift(seed: int) -> None:
    burst = _burst(SQUARE_PX, 0.0, seed)
    frames = np.array(burst.amplitude)
    frames[2, 8:20, 10:24] = np.roll(frames[2], 2, axis=1)[8:20, 10:24]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        reconstruct(replace(burst, amplitude=frames), psf_sigma_px=0.3)
    assert any("moved" in str(one.message) for one in caught)
    assert not any("is off by" in str(one.message) for one in caught)


def test_frames_that_are_not_used_keep_their_shifts() -> None:
    burst = _burst(NINE_PX, 0.1, 5)
    used = (0, 2, 3, 5, 6, 8)
    with pytest.warns(QualityWarning, match="is off by"):
        found = reconstruct(burst, frames=used, psf_sigma_px=0.3)
    assert len(found.settings["corrected_offset_px"]) == len(used)
    np.testing.assert_array_equal(
        found.amplitude.predict(4), found.amplitude.predict(tuple(burst.offset_px[4]))
    )


@pytest.mark.parametrize("channel", ["phasor", "distance"])
def test_light_that_mixes_to_nothing_mends_no_shift(reference_dir: Path, channel: str) -> None:
    """Of surfaces nearly half a turn apart amplitudes fall at edges, and are no means there."""
    with np.load(reference_dir / "irwsr" / "tofphasor_x2_4f_input.npz") as data:
        z, offset_px = np.moveaxis(data["LR"], -1, 0), -data["shifts"][:, ::-1]
    distance_m = np.angle(z) % (2 * np.pi) * 1.25 / (2 * np.pi)
    burst = make_burst(np.abs(z), offset_px, distance_m=distance_m, modulation_hz=119.9e6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = reconstruct(burst, channel=channel, std=False)
    assert "corrected_offset_px" not in found.settings


@pytest.mark.parametrize(("sigma_px", "likely"), [(0.01, "their sign"), (2.0, "shifts that the")])
def test_shifts_that_the_frames_hardly_told_have_no_wrong_sign(
    sigma_px: float, likely: str
) -> None:
    burst = _burst(NINE_PX, 0.0, 1)
    known_px = np.full(NINE_PX.shape, sigma_px)
    found = replace(burst, offset_px=-NINE_PX, offset_sigma_px=known_px, offset_source="registered")
    with pytest.warns(QualityWarning, match=f"contradict offset_px: .*; likely {likely}"):
        reconstruct(found, psf_sigma_px=0.3, std=False)
