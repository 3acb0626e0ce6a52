"""Bursts as files: netCDF-4/HDF5 that xarray, netCDF-C, h5py and NeXus readers open.

Schema `lensshift-burst/1`, group `entry/data` and the root, dimensions (frame, row, col):

    amplitude, distance   [frame row col]   dtype as given
    flags                 [frame row col]   CF flags, bit 0: invalid
    offset_row, offset_col, offset_sigma_row, offset_sigma_col   [frame]  pixel
    stage_row, stage_col, stage_commanded_row, stage_commanded_col   [frame]  mm
    time                  [frame]           s
    affine                [frame axis along] how the image of a frame turns, grows and shears
    direction             [row col xyz]     where each pixel looks, see `io.intrinsics_fields`
    phasors               [frequency frame row col]
    raw_NAME              [frame ...]       as the camera sent it
    attributes: pitch_mm (row, col), modulation_hz, offset_source, meta (JSON), those of a pinhole
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.defects import blank_frames
from lensshift.core.errors import DataError, naming
from lensshift.core.types import Burst, expect_burst
from lensshift.io import container_writer as writer
from lensshift.io.capture_file import burst_of_capture, is_capture, read_capture
from lensshift.io.container_reader import Container, open_container
from lensshift.io.intrinsics_fields import (
    intrinsics_attributes,
    intrinsics_variables,
    read_intrinsics,
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
    expect_burst(burst)
    with naming(path):
        attributes = _attributes(burst)
    writer.write_container(writer.Content(SCHEMA, _AXES, _variables(burst), attributes), path)


def _attributes(burst: Burst) -> dict[str, Any]:
    known = burst.modulation_hz
    return {
        "pitch_mm": np.asarray(burst.grid.pitch_mm, dtype=np.float64),
        "modulation_hz": None if known is None else np.asarray(known, dtype=np.float64)[()],
        "offset_source": writer.sealed_text(burst.offset_source),
        "meta": writer.sealed_text(writer.to_json(burst.meta, "meta")),
        **intrinsics_attributes(burst.intrinsics),
    }


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
        container.refuse_unfinished("frame")
        own = [name for name in container.names() if name.startswith(_RAW)]
        raw = {name.removeprefix(_RAW): container.array(name) for name in own}
        return _burst(container, (), raw=raw)


class Recording:
    """An open burst file of any length, of which parts are read; see `open_recording`."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self.offset_px = container.pairs("offset")
        self.frame_count = len(self.offset_px)

    def burst(self, first: int, count: int) -> Burst:
        """Return some frames as a burst, without what is raw; DataError if they are not there."""
        if not 0 <= first < first + count <= self.frame_count:
            problem = f"expected frames from 0 to {self.frame_count - 1}"
            raise DataError(
                f"{problem}, got {first} to {first + count - 1}", source=self._container.path
            )
        return _burst(self._container, (slice(first, first + count),))

    def time_s(self, first: int, count: int) -> NDArray[np.float64] | None:
        """Return the times [frame] of some frames, None if nobody told them."""
        return self._container.known("time", kinds="uif", part=(slice(first, first + count),))

    def shown(self, first: int, count: int) -> NDArray[np.bool_]:
        """Return which of some frames [frame] show something: not the same in all valid pixels."""
        part = (slice(first, first + count),)
        valid = (self._container.array("flags", kinds="ui", part=part) & _INVALID) == 0
        images = [self._container.known(name, part=part) for name in ("amplitude", "distance")]
        blank = [blank_frames(one, valid) for one in images if one is not None]
        return np.asarray(valid.any(axis=(1, 2)) & ~np.all(blank, axis=0))


@contextmanager
def open_recording(path: str | Path) -> Iterator[Recording]:
    """Open a burst file that may be larger than memory.

    Raises
    ------
    DataError
        As `load_burst`, or if it is an unfinished capture.
    """
    if is_capture(path):
        raise DataError("the capture is not finished; resume it", source=path)
    with open_container(path, SCHEMA) as container:
        container.refuse_unfinished("frame")
        yield Recording(container)


def write_recording(path: str | Path, frame_count: int, parts: Iterable[Burst]) -> Path:
    """Write bursts one after the other as one burst file, which may be larger than memory.

    Of one grid, modulation and kind; `meta`, intrinsics and source of the offsets are those of the
    first, raw data are left out. The file appears whole or not at all.

    Raises
    ------
    DataError
        If the parts do not hold that many frames or do not fit together, or the file cannot be
        written.
    """
    left, at = iter(parts), 0
    first = next(left, None)
    if first is None:
        raise DataError(f"expected {frame_count} frames, got 0", source=path)
    if first.phasors is not None:
        raise DataError("phasors of several frequencies are not recorded in parts", source=path)
    kind, spaces = _kind(first), dict(_of_frames(first))
    for name, one in spaces.items():
        values = writer.Allocated((frame_count, *one.values.shape[1:]), one.values.dtype, True)
        spaces[name] = replace(one, values=values)
    spaces |= intrinsics_variables(first.intrinsics) | writer.pixel_centres(first.grid.shape)
    content = writer.Content(SCHEMA, _AXES, spaces, _attributes(first))
    with naming(path), writer.writing_parts(content, path) as group:
        for part in chain([first], left):
            if _kind(part) != kind:
                problem = f"expected pitch, modulation and fields of {kind}, got {_kind(part)}"
                raise DataError(problem, field=f"frame {at}")
            end = at + part.frame_count
            if end > frame_count:
                raise DataError(f"expected {frame_count} frames, got more")
            for name, one in _of_frames(part).items():
                group[name][at:end] = one.values
            at = end
        if at < frame_count:
            raise DataError(f"expected {frame_count} frames, got {at}")
    return Path(path)


def _of_frames(burst: Burst) -> dict[str, writer.Variable]:
    """Return the variables that say something of each frame, but for what is raw."""
    found = _variables(replace(burst, raw={}, phasors=None))
    return {name: one for name, one in found.items() if one.dims[0] == "frame" != name}


def _kind(burst: Burst) -> tuple[Any, ...]:
    """Return what is the same in all parts of a recording."""
    fields = {name: one.values.shape[1:] for name, one in _of_frames(burst).items()}
    return burst.grid.pitch_mm, burst.modulation_hz, fields


def _burst(
    container: Container, part: tuple[slice, ...], *, raw: Mapping[str, NDArray[Any]] | None = None
) -> Burst:
    """Read a burst, or some of its frames."""
    fields: dict[str, Any] = {
        field: container.pairs(name, part=part)
        for field, (name, _, _) in _PAIRS.items()
        if field == "offset_px" or container.has(f"{name}_row") or container.has(f"{name}_col")
    }
    each = part and (slice(None), *part)
    flags = container.array("flags", kinds="ui", part=part)
    return Burst.from_arrays(
        container.array("amplitude", part=part), container.known("distance", part=part),
        phasors=container.known("phasors", kinds="c", part=each),
        affine=container.known("affine", kinds="uif", part=part),
        time_s=container.known("time", kinds="uif", part=part),
        pitch_mm=container.number_pair("pitch_mm"), valid=(flags & _INVALID) == 0,
        modulation_hz=container.numbers("modulation_hz"),
        offset_source=container.text("offset_source"), intrinsics=read_intrinsics(container),
        meta=container.mapping("meta"), raw=raw or {}, **fields,
    )  # fmt: skip


def _variables(burst: Burst) -> dict[str, writer.Variable]:
    label = "complex phasor" if np.iscomplexobj(burst.amplitude) else "modulation amplitude"
    variables = {"amplitude": writer.measured(_AXES, burst.amplitude, "1", label)}
    if burst.distance_m is not None:
        of = {"comment": "radial, camera frame"}
        variables["distance"] = writer.measured(_AXES, burst.distance_m, "m", "distance", **of)
    if burst.phasors is not None:
        label = "phasor of each modulation frequency"
        variables["phasors"] = writer.measured(("frequency", *_AXES), burst.phasors, "1", label)
    variables["flags"] = writer.Variable(
        _AXES, (~burst.valid).astype(np.uint8), writer.flag_attributes("invalid")
    )
    for field, (name, units, label) in _PAIRS.items():
        pairs = getattr(burst, field)
        for index, axis in enumerate(("row", "col") if pairs is not None else ()):
            along = f"{label}, along {axis}s"
            variables[f"{name}_{axis}"] = writer.measured(("frame",), pairs[:, index], units, along)
    if burst.affine is not None:
        label = "offset of a pixel by its distance from the middle, both (row, col)"
        variables["affine"] = writer.measured(("frame", "axis", "along"), burst.affine, "1", label)
    if burst.time_s is not None:
        variables["time"] = writer.measured(("frame",), burst.time_s, "s", "time of the frame")
    for name, values in burst.raw.items():  # of the size of the images, or another
        own = ("frame", *(f"{name}_{axis}" for axis in range(1, values.ndim)))
        dims = _AXES if values.shape == burst.amplitude.shape else own
        variables[f"{_RAW}{name}"] = writer.Variable(dims, values)
    variables |= intrinsics_variables(burst.intrinsics)
    variables["frame"] = writer.Variable(
        ("frame",), np.arange(burst.frame_count, dtype=np.int32), {"long_name": "frame number"}
    )
    return variables | writer.pixel_centres(burst.grid.shape)
