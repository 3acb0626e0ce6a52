"""Camera matrices of files as OpenCV, ROS and their users write them."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.intrinsics import Pinhole
from lensshift.io import load_image_stack
from lensshift.io.camera_matrix import load_pinhole

SHAPE = (132, 176)
K = [[212.5, 0.0, 87.25], [0.0, 211.0, 65.5], [0.0, 0.0, 1.0]]
D = [-0.31, 0.12, 1e-3, -2.5e-4, 0.0]
PINHOLE = Pinhole(212.5, 211.0, 87.25, 65.5, *D)
FLAT_K, FLAT_D = ("[" + ", ".join(map(str, np.ravel(one))) + "]" for one in (K, D))
LINES_K, LINES_D = ("".join(f"\n- {one}" for one in np.ravel(many)) for many in (K, D))
FILES = {
    "opencv.yml": f"""%YAML:1.0
---
image_width: 176
image_height: 132
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {FLAT_K.replace(", 0.0, 211", ",{0}       0., 211").format(chr(10))}
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: {FLAT_D}
""",
    "opencv.xml": f"""<?xml version="1.0"?><opencv_storage>
<cameraMatrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>{FLAT_K.strip("[]").replace(",", "")}</data></cameraMatrix>
<distCoeffs type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
<data>{FLAT_D.strip("[]").replace(",", "")}</data></distCoeffs></opencv_storage>""",
    "ros.yaml": f"""image_width: 176
image_height: 132
camera_name: tof
camera_matrix:
  rows: 3
  cols: 3
  data: {FLAT_K}
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: {FLAT_D}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
""",
    "echo.yaml": f"height: 132\nwidth: 176\ndistortion_model: plumb_bob\nd:{LINES_D}\nk:{LINES_K}\n"
    "r:\n- 1.0\n",
    "plain.json": json.dumps({"width": 176, "K": K, "D": [D]}, indent=2),
}


@pytest.mark.parametrize("name", FILES)
def test_a_pinhole_is_read_as_others_write_it(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(FILES[name])
    assert load_pinhole(path, SHAPE) == PINHOLE


def test_arrays_by_the_names_of_calibrate_camera_are_read(tmp_path: Path) -> None:
    frames = np.random.default_rng(2).random((4, *SHAPE))
    np.savez(tmp_path / "calib.npz", mtx=K, dist=[D])
    assert load_pinhole(tmp_path / "calib.npz", SHAPE) == PINHOLE
    np.savez(tmp_path / "burst.npz", frames=frames, K=np.transpose(K), dist=[D])
    with warnings.catch_warnings(action="error"):
        assert load_image_stack(tmp_path / "burst.npz").intrinsics == PINHOLE


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FILES["ros.yaml"].replace("plumb_bob", "equidistant"), "no pinhole; from Python"),
        (FILES["ros.yaml"].replace("176", "352"), "expected the width 176 of the frames, got 352"),
        ('{"P": [1, 2, 3]}', "expected fx 0 cx, 0 fy cy, 0 0 1 by a name like"),
        (json.dumps({"K": np.ones((3, 3)).tolist()}), "expected fx 0 cx, 0 fy cy, 0 0 1"),
        (json.dumps({"K": K, "D": [0.1] * 8}), "8 numbers of distortion"),
    ],
)
def test_what_is_no_pinhole_of_the_frames_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(DataError, match=said):
        load_pinhole(path, SHAPE)


def test_another_matrix_of_that_name_is_told_and_not_read(tmp_path: Path) -> None:
    kernel = np.outer([1.0, 2.0, 1.0], [1.0, 2.0, 1.0])
    frames = np.random.default_rng(3).normal(10.0, 1.0, (4, 12, 17))
    np.savez(tmp_path / "a.npz", frames=frames, k=kernel)
    with pytest.warns(QualityWarning, match="nothing is done with k"):
        burst = load_image_stack(tmp_path / "a.npz")
    assert burst.intrinsics is None


def test_a_depth_named_d_beside_a_camera_matrix_is_no_distortion(tmp_path: Path) -> None:
    frames = np.random.default_rng(4).normal(10.0, 1.0, (4, 12, 17))
    np.savez(tmp_path / "a.npz", frames=frames, K=K, d=0.1 * frames)
    with warnings.catch_warnings(record=True):
        burst = load_image_stack(tmp_path / "a.npz")
    assert burst.intrinsics == Pinhole(212.5, 211.0, 87.25, 65.5)
