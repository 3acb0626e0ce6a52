"""Where the pixels look as OpenCV and ROS write it: a camera matrix with distortion.

Read are YAML, XML and JSON of OpenCV, camera_info of ROS, and `numpy.savez` of what calibrateCamera
returns, by the names that they give; no more of these languages is understood.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import DataError
from lensshift.core.intrinsics import Pinhole
from lensshift.core.settings import read_text
from lensshift.io.foreign_arrays import has_names, load_named_arrays
from lensshift.io.reading import reading

MATRICES = ("camera_matrix", "cameraMatrix", "CameraMatrix", "mtx", "K", "k")
DISTORTIONS = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "dist", "D", "d")
_COUNTS = (4, 5, 8, 12, 14)  # numbers of distortion of OpenCV; of other arrays a `d` may be depth
_NUMBER = r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?"
# A list in brackets, the data of XML, or a line for each number, behind rows, cols and type.
_VALUES = rf"(?s:.{{0,200}}?)(\[[-+.\deE,\s\[\]]*\]|<data>[^<]*|(?:\n\s*-\s+{_NUMBER})+)"
_OTHER_LENS = "equidistant|fisheye|rational_polynomial|thin_prism"
_CURE = "from Python, PixelDirections of cv2.undistortPoints (cv2.fisheye's) takes any lens"


def load_pinhole(path: Path, shape: tuple[int, int]) -> Pinhole:
    """Read the pinhole of an image of this shape (rows, cols); DataError if it is none of it."""
    with reading(path):
        if has_names(path):
            found: Mapping[str, Any] = load_named_arrays(path)
        else:
            text = read_text(path)
            if other := re.search(_OTHER_LENS, text):
                raise DataError(f"the lens is {other[0]}, no pinhole; {_CURE}")
            found = {
                n: v for n in (*MATRICES, *DISTORTIONS) if (v := _numbers(text, n)) is not None
            }
            for axis, size in zip(("height", "width"), shape, strict=True):
                told = re.search(rf"{axis}[\"']?\s*[:>]\s*(\d+)", text)
                if told and int(told[1]) != size:
                    problem = f"expected the {axis} {size} of the frames, got {told[1]}"
                    raise DataError(f"{problem}; calibrate at the size at which they were taken")
        pinhole = pinhole_of(found)
        if pinhole is None:
            form = "fx 0 cx, 0 fy cy, 0 0 1"
            raise DataError(f"expected {form} by a name like {', '.join(MATRICES[:5])}")
        return pinhole


def pinhole_of(fields: Mapping[str, ArrayLike]) -> Pinhole | None:
    """Return the pinhole of a camera matrix [3 3] among fields, None without one."""
    found = ((one, _matrix(fields[one])) for one in MATRICES if one in fields)
    name, matrix = next((pair for pair in found if pair[1] is not None), ("", None))
    if matrix is None:
        return None
    told = next((fields[one] for one in DISTORTIONS if np.size(fields.get(one, ())) in _COUNTS), ())
    distortion = np.ravel(np.asarray(told, np.float64))
    if np.any(distortion[5:]):
        raise DataError(f"{distortion.size} numbers of distortion; {_CURE}", field=name)
    (fx_px, _, cx_px), (_, fy_px, cy_px), _ = matrix.tolist()
    return Pinhole(fx_px, fy_px, cx_px, cy_px, *distortion[:5].tolist())


def _matrix(given: ArrayLike) -> Floats | None:
    """Return fx 0 cx, 0 fy cy, 0 0 1, or None of anything else that has such a name."""
    values = np.asarray(given)
    if values.size != 9 or values.dtype.kind not in "fiu":
        return None
    matrix = values.reshape(3, 3).astype(np.float64)
    if matrix[0, 2] == 0 != matrix[2, 0]:  # as MATLAB has it
        matrix = matrix.T
    pinhole = not np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]]) and matrix[2, 2] == 1
    return matrix if pinhole and np.all(np.diag(matrix) > 0) else None


def _numbers(text: str, name: str) -> list[float] | None:
    """Return the numbers that stand behind a name."""
    found = re.search(rf"(?<![\w]){name}\b[\"']?\s*(?::|[^<>\n]*>){_VALUES}", text)
    return [float(one) for one in re.findall(_NUMBER, found[1])] if found else None
