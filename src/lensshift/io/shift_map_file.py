"""Shift maps: how far the image moves at every pixel, and per mm of the stage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.errors import DataError
from lensshift.core.motion import ShiftField, StageMap
from lensshift.core.types import Burst
from lensshift.io.atomic import written_whole
from lensshift.io.image_file import load_named_arrays

T = TypeVar("T")

SCHEMA = "lensshift-shift-map/1"


def save_shift_map(
    path: str | Path,
    field: ShiftField,
    *,
    stage_map: StageMap | None = None,
    stage_mm: ArrayLike | None = None,
) -> None:
    """Write a shift map as a NumPy archive (.npz).

    Arrays: `offset_px` [frame row col 2]; if known, `pitch_mm` [2]; if given, `px_per_mm` [2 2],
    `field_px_per_mm` [row col 2 2] and `sigma_px` of the stage map, and `stage_mm` [frame 2], where
    the stage has to go for each frame. `schema` tells the version.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    arrays: dict[str, NDArray[np.generic]] = {"offset_px": field.offset_px}
    arrays["schema"] = np.array(SCHEMA)
    if field.pitch_mm is not None:
        arrays["pitch_mm"] = np.array(field.pitch_mm)
    if stage_map is not None:
        arrays |= {"px_per_mm": stage_map.px_per_mm, "sigma_px": np.array(stage_map.sigma_px)}
        if stage_map.field_px_per_mm is not None:
            arrays["field_px_per_mm"] = stage_map.field_px_per_mm
    if stage_mm is not None:
        arrays["stage_mm"] = np.asarray(stage_mm, dtype=np.float64)
    with written_whole(path) as part, part.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_shift_field(path: str | Path, burst: Burst | None = None) -> ShiftField:
    """Read the offsets [frame row col 2] of a shift map.

    Parameters
    ----------
    burst : the burst that the map has to belong to, if that is wanted

    Raises
    ------
    DataError
        If the file is missing, no such archive, holds no field of offsets or that of another burst.
    """
    field = _built(path, "offset_px", _field)
    if burst is not None:
        try:
            field.check_belongs(burst.offset_px, burst.grid)
        except DataError as error:
            raise error.in_file(path) from error
    return field


def _field(arrays: dict[str, NDArray[Any]]) -> ShiftField:
    if "pitch_mm" not in arrays:
        return ShiftField(arrays["offset_px"])
    row_mm, col_mm = np.asarray(arrays["pitch_mm"], dtype=np.float64)
    return ShiftField(arrays["offset_px"], (float(row_mm), float(col_mm)))


def load_stage_map(path: str | Path) -> StageMap:
    """Read the stage map of a shift map.

    Raises
    ------
    DataError
        If the file is missing, no such archive, or holds no stage map.
    """
    return _built(
        path,
        "px_per_mm",
        lambda arrays: StageMap(
            np.asarray(arrays["px_per_mm"], dtype=np.float64),
            arrays.get("field_px_per_mm"),
            float(arrays.get("sigma_px", 0.0)),
        ),
    )


def _built(path: str | Path, name: str, build: Callable[[dict[str, NDArray[Any]]], T]) -> T:
    arrays = load_named_arrays(path)
    if name not in arrays:
        known = ", ".join(arrays) or "nothing"
        raise DataError(f"expected this array, got {known}", field=name, source=path)
    try:
        return build(arrays)
    except (ValueError, TypeError) as error:
        raise DataError(str(error), field=name, source=path) from error
