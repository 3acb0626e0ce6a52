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

It is allocated at once, filled piece by piece, and called NAME.part until it is whole. Arrays that
are filled lie in one run of bytes each, whose place is known once the file is made, so filling them
is plain writing: HDF5, which a kill in the middle would leave damaged, is not open meanwhile. The
variable `written` says which pieces are there; what was begun with the same settings is gone on
with.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from lensshift.core.atomic import GrowingFile, writable_target
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Intrinsics
from lensshift.core.settings import parse_json
from lensshift.core.types import Estimate, Reconstruction, Status
from lensshift.io import container_writer as writer
from lensshift.io.capture_file import lock
from lensshift.io.container_reader import WRITTEN, open_container
from lensshift.io.intrinsics_fields import intrinsics_variables
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


class PiecewiseFile(GrowingFile):
    """A container whose first dimension is filled in pieces; use `begin`, in a `with` block."""

    def __init__(
        self,
        target: Path,
        part: Path,
        file: BinaryIO,
        starts: Mapping[str, int],
        spaces: Mapping[str, writer.Allocated],
        written: NDArray[np.bool_],  # [piece] which pieces are there
    ) -> None:
        super().__init__(file)
        self.written, self._target, self._part = written, target, part
        self._starts, self._spaces = dict(starts), dict(spaces)

    @classmethod
    def begin(cls, path: str | Path, content: writer.Content, begun: str) -> Self:
        """Allocate a file, or go on with what was `begun` with the same text of settings (JSON).

        Variables with `Allocated` values are filled later; their first dimension is that of the
        first variable. DataError if there is no room, or the file is another's.
        """
        writer.refuse_other_ending(path)
        target = writable_target(path)
        part = target.with_name(f"{target.name}.part")
        first = next(iter(content.variables.values()))
        space = writer.Allocated((first.values.shape[0],), np.dtype("<u1"))
        written = writer.measured((first.dims[0],), space, "1", "1 where the piece was written")
        variables = {**content.variables, WRITTEN: written}
        spaces = {
            k: v.values for k, v in variables.items() if isinstance(v.values, writer.Allocated)
        }
        if not part.exists():
            needed = sum(math.prod(one.shape) * one.dtype.itemsize for one in spaces.values())
            free = shutil.disk_usage(target.parent).free
            if needed > free:
                problem = f"the file takes {needed / 1e6:.1f} MB, {free / 1e6:.1f} MB are free"
                raise DataError(problem, source=target)
            described = {**content.attributes, "begun": writer.sealed_text(begun)}
            whole = replace(content, variables=variables, attributes=described)
            writer.write_container(whole, part)
        with open_container(part, content.schema) as container:
            if container.text("begun") != begun:
                told = (parse_json(one, part, "begun") for one in (container.text("begun"), begun))
                problem = (
                    f"{part.name} was begun with other settings or of another recording "
                    f"({otherwise(*told)}); give those, choose another name, or remove it"
                )
                raise DataError(problem, source=path)
            starts = {name: container.start_of(name) for name in spaces}
            there = container.array(WRITTEN) != 0
        file = part.open("r+b", buffering=0)
        try:
            lock(file, part)
        except DataError:
            file.close()
            raise
        return cls(target, part, file, starts, spaces, there)

    def write(self, first: int, pieces: Mapping[str, NDArray[Any]]) -> None:
        """Write consecutive pieces [piece ...], which count once all arrays have them; or raise."""
        count = len(next(iter(pieces.values())))
        if set(pieces) != set(self._spaces) - {WRITTEN}:
            raise DataError(f"expected {sorted(self._spaces)}, got {sorted(pieces)}")
        for name, values in (*pieces.items(), (WRITTEN, np.ones(count))):
            space = self._spaces[name]
            if np.shape(values) != (count, *space.shape[1:]):
                raise DataError(
                    f"expected {(count, *space.shape[1:])}, got {np.shape(values)}", field=name
                )
            stride = math.prod(space.shape[1:]) * space.dtype.itemsize
            try:
                self._file.seek(self._starts[name] + first * stride)
                self._put(memoryview(np.asarray(values, space.dtype).tobytes()))
            except OSError as error:
                kept = f"{int(self.written.sum())} pieces are kept"
                problem = f"cannot write: {error.strerror}; {kept}"
                raise DataError(problem, source=self._part) from error
        self.written[first : first + count] = True

    def finish(self) -> Path:
        """Give the file its name. DataError if pieces are missing."""
        missing = int(np.sum(~self.written))
        if missing:
            raise DataError(f"{missing} pieces are missing", source=self._part)
        self._file.close()
        return self._part.replace(self._target)


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


def otherwise(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Name what differs from before; "" if nothing does."""
    return ", ".join(f"{k} {before.get(k)}, not {v}" for k, v in now.items() if before.get(k) != v)


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
