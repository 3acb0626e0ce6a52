"""A running camera sees what the camera that casts every frame anew sees."""

from dataclasses import replace

import numpy as np
import pytest

from lensshift.camera import (
    Multipath,
    PlainOptics,
    RunningCamera,
    TofCamera,
    camera_preset,
    simulate_tof,
)
from lensshift.core.grid import Grid
from lensshift.scene import Scene, four_boxes


@pytest.fixture(scope="module")
def camera() -> TofCamera:
    small = replace(camera_preset("o3m151"), grid=Grid((7, 12), (0.31, 0.31))).ideal()
    return replace(small, optics=PlainOptics(42.7, 2.1, blur_sigma_px=0.1))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return four_boxes()


@pytest.fixture(scope="module")
def running(camera: TofCamera, scene: Scene) -> RunningCamera:
    return RunningCamera(scene, camera, reach_px=0.6)


def test_frames_equal_those_cast_for_their_offset(
    running: RunningCamera, camera: TofCamera, scene: Scene
) -> None:
    offset = [0.13, -0.37]
    cast = simulate_tof(scene, camera, [offset], shift_error_px=0.0)
    image = running.frame([offset], np.random.default_rng(0))
    size = cast.burst.amplitude.max()
    np.testing.assert_allclose(image.amplitude, cast.burst.amplitude[0], atol=2e-3 * size)
    amplitude, distance_m = running.truth(2)
    np.testing.assert_allclose(amplitude, cast.truth.amplitude, atol=5e-3 * size)
    far = np.abs(distance_m - cast.truth.distance_m)
    assert np.median(far) < 1e-3


def test_content_moves_down_and_right(running: RunningCamera) -> None:
    """The HR truth moved by one HR pixel is the HR truth, one pixel further."""
    still, _ = running.truth(2)
    moved, _ = running.truth(2, [0.5, 0.0])
    np.testing.assert_allclose(moved[1:], still[:-1], rtol=1e-9)
    moved, _ = running.truth(2, [0.0, 0.5])
    np.testing.assert_allclose(moved[:, 1:], still[:, :-1], rtol=1e-9)


def test_an_exposure_while_the_lens_moves_is_the_mean(running: RunningCamera) -> None:
    rng = np.random.default_rng(1)
    a, b = (running.seen([0.0, at]).phasor[0, 0] for at in (-0.2, 0.4))
    both = running.frame([[0.0, -0.2], [0.0, 0.4]], rng).amplitude
    ones = running.frame([[0.0, -0.2]], rng).amplitude
    np.testing.assert_allclose(both / ones, np.abs(a + b) / 2 / np.abs(a), rtol=1e-9)


def test_a_field_moves_each_pixel_by_its_own_offset(running: RunningCamera) -> None:
    field = np.zeros((7, 12, 2))
    field[:, 6:] = (0.2, -0.1)
    mixed = running.seen(field).light
    np.testing.assert_array_equal(mixed[:, :6], running.seen([0.0, 0.0]).light[:, :6])
    np.testing.assert_array_equal(mixed[:, 6:], running.seen([0.2, -0.1]).light[:, 6:])


def test_what_it_cannot_do_is_refused(camera: TofCamera, scene: Scene) -> None:
    with pytest.raises(ValueError, match="no indirect light"):
        RunningCamera(scene, replace(camera, multipath=Multipath()))


def test_offsets_beyond_its_reach_are_refused(running: RunningCamera) -> None:
    with pytest.raises(ValueError, match=r"at most 0\.6 px"):
        running.seen([0.7, 0.0])
