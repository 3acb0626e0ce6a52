"""Where the pixels look, as fields of the files of bursts and results.

focal_px (row, col), centre_px (row, col), distortion (k1, k2, p1, p2, k3)   of a pinhole
direction   [row col xyz]   (x right, y down, z forward), length 1           of each pixel
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, about
from lensshift.core.intrinsics import Intrinsics, Pinhole, PixelDirections
from lensshift.io.container_reader import Container
from lensshift.io.container_writer import Variable, measured

_COUNTS = {"focal_px": 2, "centre_px": 2, "distortion": 5}
NAMES = (*_COUNTS, "direction")


def intrinsics_fields(intrinsics: Intrinsics | None) -> dict[str, NDArray[np.float64]]:
    """Return the fields that say where the pixels look; none if that is not known."""
    if intrinsics is None:
        return {}
    if isinstance(intrinsics, PixelDirections):
        return {"direction": intrinsics.direction}
    fx_px, fy_px, cx_px, cy_px, *distortion = astuple(intrinsics)
    values = ((fy_px, fx_px), (cy_px, cx_px), distortion)
    return {name: np.array(value) for name, value in zip(_COUNTS, values, strict=True)}


def intrinsics_variables(intrinsics: Intrinsics | None) -> dict[str, Variable]:
    """Return the variables of a container: directions of pixels, if there are any."""
    if not isinstance(intrinsics, PixelDirections):
        return {}
    dims, meaning = ("row", "col", "xyz"), "direction of the pixel: right, down, forward"
    return {"direction": measured(dims, intrinsics.direction, "1", meaning)}


def intrinsics_attributes(intrinsics: Intrinsics | None) -> dict[str, NDArray[np.float64]]:
    """Return the attributes of a container: the numbers of a pinhole, if it is one."""
    return {} if isinstance(intrinsics, PixelDirections) else intrinsics_fields(intrinsics)


def intrinsics_of_fields(fields: Mapping[str, Any]) -> Intrinsics | None:
    """Return what fields say of where the pixels look, or None; DataError if it cannot be."""
    with about("intrinsics"):
        if "direction" in fields:
            return PixelDirections(np.asarray(fields["direction"], dtype=np.float64))
        if not any(name in fields for name in _COUNTS):
            return None
        focal, centre, distortion = (_numbers(fields, name, n) for name, n in _COUNTS.items())
        return Pinhole(focal[1], focal[0], centre[1], centre[0], *distortion)


def read_intrinsics(container: Container) -> Intrinsics | None:
    """Return where the pixels look by the fields of a container; `DataError` as above."""
    found: dict[str, Any] = {name: container.numbers(name) for name in _COUNTS}
    found["direction"] = container.known("direction", kinds="uif")
    return intrinsics_of_fields({name: one for name, one in found.items() if one is not None})


def _numbers(fields: Mapping[str, Any], name: str, count: int) -> list[float]:
    values = np.asarray(fields.get(name, ()), dtype=np.float64)
    if values.shape != (count,):
        raise DataError(f"expected {count} numbers, got shape {values.shape}", field=name)
    return [float(value) for value in values]
