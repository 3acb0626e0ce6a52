"""Bursts as files: netCDF-4/HDF5 that xarray, netCDF-C, h5py and NeXus readers open.

Schema `lensshift-burst/1`, group `entry/data` and the root, dimensions (frame, row, col):

    amplitude, distance   [frame row col]   dtype as given
    flags                 [frame row col]   CF flags, bit 0: invalid
    offset_row, offset_col, offset_sigma_row, offset_sigma_col   [frame]  pixel
    stage_row, stage_col, stage_commanded_row, stage_commanded_col   [frame]  mm
    time                  [frame]           s
    direction             [row col xyz]     where each pixel looks, see `io.intrinsics_fields`
    phasors               [frequency frame row col]
    raw_NAME              [frame ...]       as the camera sent it
    attributes: pitch_mm (row, col), modulation_hz, offset_source, meta (JSON), those of a pinhole
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.core.types import Burst
from lensshift.io.capture_file import burst_of_capture, is_capture, read_capture
from lensshift.io.container_reader import open_container
from lensshift.io.container_writer import (
    Variable,
    pixel_centres,
    sealed_text,
    to_json,
    write_container,
)
from lensshift.io.intrinsics_fields import (
    NAMES,
    intrinsics_attributes,
    intrinsics_of_fields,
    intrinsics_variables,
)

SCHEMA = "lensshift-burst/1"
_AXES = ("frame", "row", "col")
_INVALID = np.uint8(1)
_RAW = "raw_"
# Field of `Burst` -> (name in the file, unit, what it is)
_PAIRS = {
    "offset_px": ("offset", "pixel", "image offset; positive: content moved down / right"),
    "offset_sigma_px": ("offset_sigma", "pixel", "standard deviation of the image offset"),
    "stage_mm": ("stage", "mm", "lens position read back"),
    "stage_commanded_mm": ("stage_commanded", "mm", "lens position asked for"),
}


def save_burst(burst: Burst, path: str | Path) -> None:
    """Write a burst to a file that appears whole or not at all.

    Raises
    ------
    DataError
        If the file cannot be written, or a dtype or `meta` cannot be stored.
    """
    try:
        meta = to_json(burst.meta, "meta")
    except DataError as error:
        raise error.in_file(path) from error
    write_container(
        path,
        schema=SCHEMA,
        axes=_AXES,
        variables=_variables(burst),
        attributes={
            "pitch_mm": np.asarray(burst.grid.pitch_mm, dtype=np.float64),
            "modulation_hz": _frequencies(burst),
            "offset_source": sealed_text(burst.offset_source),
            "meta": sealed_text(meta),
            **intrinsics_attributes(burst.intrinsics),
        },
    )


def load_burst(path: str | Path) -> Burst:
    """Read a burst that `save_burst` wrote, or the frames so far of an unfinished capture.

    Raises
    ------
    DataError
        If the file is missing, damaged, of another schema, or contradicts itself; the message
        names the file and the field.
    """
    if is_capture(path):
        return burst_of_capture(*read_capture(path), Path(path))
    with open_container(path, SCHEMA) as container:
        fields: dict[str, Any] = {
            field: container.pairs(name)
            for field, (name, _, _) in _PAIRS.items()
            if field == "offset_px" or container.has(f"{name}_row") or container.has(f"{name}_col")
        }
        if container.has("distance"):
            fields["distance_m"] = container.array("distance")
        if container.has("phasors"):
            fields["phasors"] = container.array("phasors", kinds="c")
        if container.has("time"):
            fields["time_s"] = container.array("time", kinds="uif")
        fields["raw"] = {
            name.removeprefix(_RAW): container.array(name)
            for name in container.names()
            if name.startswith(_RAW)
        }
        flags = container.array("flags", kinds="ui")
        return Burst.from_arrays(
            container.array("amplitude"),
            pitch_mm=container.number_pair("pitch_mm"),
            valid=(flags & _INVALID) == 0,
            modulation_hz=container.numbers("modulation_hz"),
            offset_source=container.text("offset_source"),
            intrinsics=intrinsics_of_fields(container.fields(NAMES)),
            meta=container.mapping("meta"),
            **fields,
        )


def _variables(burst: Burst) -> dict[str, Variable]:
    label = "complex phasor" if np.iscomplexobj(burst.amplitude) else "modulation amplitude"
    variables = {"amplitude": Variable(_AXES, burst.amplitude, {"units": "1", "long_name": label})}
    if burst.distance_m is not None:
        described = {"units": "m", "long_name": "distance", "comment": "radial, camera frame"}
        variables["distance"] = Variable(_AXES, burst.distance_m, described)
    if burst.phasors is not None:
        described = {"units": "1", "long_name": "phasor of each modulation frequency"}
        variables["phasors"] = Variable(("frequency", *_AXES), burst.phasors, described)
    variables["flags"] = Variable(_AXES, _flags(burst), _flag_attributes())
    for field, (name, units, label) in _PAIRS.items():
        pairs = getattr(burst, field)
        for index, axis in enumerate(("row", "col") if pairs is not None else ()):
            described = {"units": units, "long_name": f"{label}, along {axis}s"}
            variables[f"{name}_{axis}"] = Variable(("frame",), pairs[:, index], described)
    if burst.time_s is not None:
        described = {"units": "s", "long_name": "time of the frame"}
        variables["time"] = Variable(("frame",), burst.time_s, described)
    for name, values in burst.raw.items():
        variables[f"{_RAW}{name}"] = Variable(_raw_axes(burst, name, values), values)
    variables |= intrinsics_variables(burst.intrinsics)
    variables["frame"] = Variable(
        ("frame",), np.arange(burst.frame_count, dtype=np.int32), {"long_name": "frame number"}
    )
    return variables | pixel_centres(burst.grid.shape)


def _raw_axes(burst: Burst, name: str, values: NDArray[Any]) -> tuple[str, ...]:
    """Return the dimensions of what a camera sent: those of the images, or its own."""
    if values.shape == burst.amplitude.shape:
        return _AXES
    return ("frame", *(f"{name}_{axis}" for axis in range(1, values.ndim)))


def _flags(burst: Burst) -> NDArray[np.uint8]:
    if burst.valid is None:
        return np.zeros(burst.amplitude.shape, dtype=np.uint8)
    return np.where(burst.valid, np.uint8(0), _INVALID)


def _flag_attributes() -> dict[str, Any]:
    return {
        "long_name": "quality flags",
        "flag_masks": np.asarray([_INVALID]),
        "flag_meanings": "invalid",
    }


def _frequencies(burst: Burst) -> Any:
    known = burst.modulation_hz
    return np.asarray(known) if isinstance(known, tuple) else known and np.float64(known)
