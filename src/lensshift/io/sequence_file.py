"""Pictures of the windows of a recording as one file, which may be larger than memory.

Schema `lensshift-sequence/1`, group `entry/data` and the root, dimensions (window, row, col) of the
HR grid:

    amplitude, amplitude_std, distance, distance_std   [window row col]   float32
    flags          [window row col]   CF flags, bit 0: flying
    misfit         [window]           mean square residual in units of the noise
    first_frame    [window]           number of its first frame in the recording
    time           [window]           s, mean of its frames; NaN if the recording has none
    refined, contradicted, written    [window]   0 or 1
    attributes: pitch_mm of the HR grid, scale, method, settings (JSON), those of a pinhole
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Intrinsics
from lensshift.core.types import Estimate, Reconstruction, Status
from lensshift.io import container_writer as writer
from lensshift.io.container_reader import WRITTEN, open_container
from lensshift.io.intrinsics_fields import intrinsics_variables
from lensshift.io.piecewise_file import PiecewiseFile
from lensshift.io.result_file import CHANNELS, picture_attributes, read_picture

SCHEMA = "lensshift-sequence/1"
_AXES = ("window", "row", "col")
_NUMBERS = {
    "misfit": ("<f4", "1", "mean square residual in units of the noise"),
    "first_frame": ("<i8", "1", "number of the first frame in the recording"),
    "time": ("<f8", "s", "mean time of the frames"),
    "refined": ("<u1", "1", "1: all stages of the solver, 0: the last one"),
    "contradicted": ("<u1", "1", "1: the frames contradict the picture"),
}


def begin_sequence(
    path: str | Path,
    windows: int,
    grid: Grid,
    channels: tuple[str, ...],  # among "amplitude" and "distance"
    *,
    scale: int,
    method: str,
    settings: Mapping[str, Any],
    flying: bool,  # whether there are flags
    intrinsics: Intrinsics | None,
) -> PiecewiseFile:
    """Begin the file of a sequence of HR pictures, or go on with it, see `PiecewiseFile.begin`."""
    variables: dict[str, writer.Variable] = {}
    for channel in channels:
        units, label = CHANNELS[channel]
        for part, meaning in (("", label), ("_std", f"standard deviation of {label}")):
            described: dict[str, Any] = {"units": units, "long_name": meaning}
            variables[channel + part] = _space((windows, *grid.shape), "<f4", described)
    if flying:
        variables["flags"] = _space((windows, *grid.shape), "<u1", writer.flag_attributes("flying"))
    for name, (dtype, units, meaning) in _NUMBERS.items():
        variables[name] = _space((windows,), dtype, {"units": units, "long_name": meaning})
    said = writer.to_json(settings, "settings")
    variables |= intrinsics_variables(intrinsics) | writer.pixel_centres(grid.shape)
    attributes = picture_attributes(grid, intrinsics, scale, method, said)
    return PiecewiseFile.begin(path, writer.Content(SCHEMA, _AXES, variables, attributes), said)


def of_sequence(found: Reconstruction) -> dict[str, NDArray[Any]]:
    """Return the fields of one window of a sequence that a reconstruction knows itself."""
    fields: dict[str, NDArray[Any]] = {}
    for name, estimate in found.channels.items():
        fields[name] = np.asarray(estimate.image, np.float32)
        std = np.full(estimate.image.shape, np.nan) if estimate.std is None else estimate.std
        fields[f"{name}_std"] = np.asarray(std, np.float32)
    if found.flying is not None:
        fields["flags"] = np.asarray(found.flying, np.uint8)
    first = next(iter(found.channels.values()))
    fields["misfit"] = np.array(first.notes.get("misfit", np.nan))
    contradicted = any(one.status is Status.CONTRADICTED for one in found.channels.values())
    fields["contradicted"] = np.array(contradicted)
    return fields


def sequence_numbers(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read what a sequence says of each window [window]: first_frame, time, misfit and so on.

    `written` is 0 where a sequence that was broken off has no picture yet.
    """
    with open_container(path, SCHEMA) as container:
        return {name: container.array(name) for name in (*_NUMBERS, WRITTEN)}


def load_window(path: str | Path, number: int) -> Reconstruction:
    """Read the picture of one window of a sequence.

    Raises
    ------
    DataError
        If the file is missing, damaged or no sequence, or there is no such window (yet).
    """
    with open_container(path, SCHEMA) as container:
        count = container.shape("first_frame")[0]
        if not 0 <= number < count:
            raise DataError(f"expected a window from 0 to {count - 1}, got {number}")
        container.refuse_unfinished("window", number)
        one = (slice(number, number + 1),)
        contradicted = bool(container.array("contradicted", part=one)[0])
        status = Status.CONTRADICTED if contradicted else Status.COMPLETE
        channels = {}
        for name in CHANNELS:
            if container.has(name):
                values, std = (container.array(n, part=one)[0] for n in (name, f"{name}_std"))
                channels[name] = Estimate(values, std, status=status)
        if not channels:
            raise DataError("there is neither an amplitude nor a distance channel")
        flags = container.known("flags", part=one)
        flying = None if flags is None else flags[0] != 0
        scale = int(container.number("scale") or 1)
        settings = container.mapping("settings") | {"window": number}
        return read_picture(container, channels, scale, settings, flying)


def _space(shape: tuple[int, ...], dtype: str, described: Mapping[str, Any]) -> writer.Variable:
    return writer.Variable(_AXES[: len(shape)], writer.Allocated(shape, np.dtype(dtype)), described)
