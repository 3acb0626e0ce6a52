"""The whole chain over real protocols, and the world behind the emulated devices."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lensshift.camera import camera_preset
from lensshift.capture.emulators.rig import EmulatedWorld, RigSettings
from lensshift.core.grid import Grid
from lensshift.io.calibration_file import load_calibration
from lensshift.pipeline.rig import run_emulated

REST_MM = np.array([3.0, 3.0])


@pytest.fixture(scope="module")
def settings() -> RigSettings:
    camera = replace(camera_preset("o3m151").ideal(), grid=Grid((5, 9), (0.31, 0.31)))
    return RigSettings(camera=camera, rest_mm=REST_MM)


def test_the_image_moves_as_the_map_says(settings: RigSettings) -> None:
    world = EmulatedWorld(settings, lambda _: REST_MM)
    step_mm = np.array([0.04, -0.03])
    offset = world.offset_px(REST_MM + step_mm)
    np.testing.assert_allclose(offset[2, 4], settings.px_per_mm @ step_mm)
    far = np.linalg.norm(offset[2, 0]) / np.linalg.norm(offset[2, 4])
    assert far == pytest.approx(1.0 + settings.field_share)


def test_a_frame_shows_where_the_lens_was_while_it_was_exposed(settings: RigSettings) -> None:
    def lens_mm(instant_s: float) -> np.ndarray:
        return REST_MM + (0.0 if instant_s < 10.0 else 0.1)

    world = EmulatedWorld(settings, lens_mm)
    before, moving, after = (world.look(start, start + 1.0) for start in (8.0, 9.5, 10.5))
    assert np.abs(after.amplitude - before.amplitude).max() > 0.01
    np.testing.assert_allclose(
        moving.amplitude, 0.5 * (before.amplitude + after.amplitude), atol=0.02
    )
    np.testing.assert_array_equal(before.amplitude, world.look(7.0, 8.0).amplitude)


@pytest.mark.slow
def test_an_emulated_rig_calibrates_itself_and_captures(tmp_path: Path) -> None:
    """A mirrored map, play of 6 um, encoder noise of 1 um, damaged messages, lost packets."""
    summary = run_emulated(tmp_path)
    assert summary.shift_rms_px["nominal"] > 0.2
    assert summary.shift_rms_px["calibrated"] <= 0.01
    assert summary.shift_rms_px["calibrated over the sensor"] <= 0.01
    psnr = {name: numbers["psnr_db"] for name, numbers in summary.fidelity.items()}
    assert psnr["auto, calibrated shifts"] > psnr["bicubic"] + 6.0
    assert summary.counts["lost_packets"] > 0
    assert all(path.exists() for path in summary.files)
    found = load_calibration(tmp_path / "calibration.json")
    np.testing.assert_allclose(found.play_mm, 0.006, atol=0.003)
