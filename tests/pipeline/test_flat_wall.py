"""The whole way of a flat wall: through a camera, the reconstruction and a file of points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lensshift
from lensshift.camera import TofCamera, camera_preset, preset_names, simulate_tof
from lensshift.core.point_cloud import make_cloud
from lensshift.io import export_reconstruction
from lensshift.pipeline.experiment_file import named_optics
from lensshift.scene import Plane, Scene

FLAT_M = 1e-3
# Without noise the errors of prediction are those of the model, which do not tell shifts.
pytestmark = pytest.mark.filterwarnings("ignore:the frames contradict offset_px")


def off_plane_m(point_m: np.ndarray) -> float:
    """Return the rms distance from the plane that fits best."""
    away = point_m - point_m.mean(axis=0)
    return float(np.linalg.svd(away, compute_uv=False)[-1] / np.sqrt(len(away)))


def exported(camera: TofCamera, scale: int, path: Path) -> np.ndarray:
    """Return the points that another program reads of a slanted wall."""
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    wall = Plane(centre_m=(0.0, 0.0, 3.0), turn_rad=(0.1, -0.2, 0.0), reflectance=0.5)
    settings = {"scale": scale, "shift_error_px": 0.0, "samples_per_px": 4}  # no edges
    capture = simulate_tof(Scene((wall,)), camera.ideal(), **settings)
    intrinsics = capture.burst.intrinsics
    assert intrinsics is not None
    true = make_cloud(capture.truth.distance_m, intrinsics.refine(scale))
    assert off_plane_m(true.point_m) < 1e-5
    result = lensshift.reconstruct(capture.burst, scale, std=False)
    export_reconstruction(result, path, keep_flying=True)
    read = np.asarray(trimesh.load(path).vertices, float)
    assert len(read) == result.grid.shape[0] * result.grid.shape[1]
    return read


@pytest.mark.parametrize("optics", ["plain", "petzval_a"])
def test_a_wall_is_flat_in_the_points_of_a_small_camera(tmp_path: Path, optics: str) -> None:
    camera = camera_preset("o3m151")
    if optics != "plain":
        camera = replace(camera, optics=named_optics(optics, 1))
    assert off_plane_m(exported(camera, 2, tmp_path / "wall.ply")) < FLAT_M


@pytest.mark.slow
@pytest.mark.parametrize("name", preset_names())
def test_a_wall_is_flat_in_the_points_of_every_preset(tmp_path: Path, name: str) -> None:
    assert off_plane_m(exported(camera_preset(name), 2, tmp_path / "wall.ply")) < FLAT_M
