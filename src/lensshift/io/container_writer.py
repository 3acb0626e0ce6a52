"""Write the self-describing container of bursts and results: netCDF-4, HDF5 and NeXus in one.

All content lies in the group `entry/data`, and the root shows the same variables and attributes.
netCDF readers see a dataset with named dimensions, NeXus readers an `NXdata` with a default plot,
HDF5 readers plain datasets. Every dataset carries
a checksum and the file uses HDF5's checksummed headers (HDF5 1.10 or later), so that damage is
noticed rather than read as numbers.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, is_dataclass
from enum import Enum
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.atomic import written_whole
from lensshift.core.errors import DataError, naming

GROUP = "entry/data"
CHUNK_BYTES = 1_000_000  # what HDF5 caches by default
_LIBVER = ("v110", "v110")
_OTHERS = frozenset([
    ".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".npy", ".npz", ".fits", ".fit", ".fts",
    ".ply", ".pcd", ".mcap", ".rrd", ".csv", ".json", ".txt", ".toml", ".zip",
])  # fmt: skip
_STORABLE = frozenset(["u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f4", "f8", "c8", "c16"])


@dataclass(frozen=True, slots=True)
class Allocated:
    """Space for an array that is filled later, packed or as one run of bytes."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    packed: bool = False

    @property
    def ndim(self) -> int:
        """Number of dimensions."""
        return len(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Variable:
    """One array with named dimensions and its attributes (`units` and so on)."""

    dims: tuple[str, ...]
    values: NDArray[Any] | Allocated
    attributes: Mapping[str, Any] = field(default_factory=dict)


def measured(
    dims: tuple[str, ...], values: ArrayLike | Allocated, units: str, meaning: str, **more: Any
) -> Variable:
    """Return a variable with its unit, what it is, and further attributes."""
    held = values if isinstance(values, Allocated) else np.asarray(values)
    return Variable(dims, held, {"units": units, "long_name": meaning, **more})


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What a container holds."""

    schema: str  # name and version of the layout, as in "lensshift-burst/1"
    axes: Sequence[str]  # dimensions of the first variable, which is the default plot
    variables: Mapping[str, Variable]  # arrays by name; a dimension has the same length everywhere
    attributes: Mapping[str, Any]  # of the whole set; None is left out, text and numbers are kept


def refuse_other_ending(path: str | Path) -> None:
    """Raise a `DataError` if a name promises another format to whoever opens the file."""
    if Path(path).suffix.lower() in _OTHERS:
        raise DataError(
            "expected a name that ends in .nc, for a netCDF file is written; export_burst and "
            "export_reconstruction of lensshift.io write others",
            source=path,
        )


def write_container(content: Content, path: str | Path) -> None:
    """Write variables and attributes to a new file in one step; DataError if one does not fit."""
    with writing_parts(content, path):
        pass


@contextmanager
def writing_parts(content: Content, path: str | Path) -> Iterator[Any]:
    """Yield the group of a new file's variables, to fill what is `Allocated`; else as above."""
    import h5py

    refuse_other_ending(path)
    with naming(path):
        lengths = _dimension_lengths(content.variables)
    with written_whole(path) as temporary, _Enduring(temporary) as file:
        _write_hdf5(content, lengths, file)
        with h5py.File(file, "r+", libver=_LIBVER) as opened:
            yield opened[GROUP]
            file.check()


class _Enduring(FileIO):
    """A new file for HDF5, which crashes where it cannot write: it is told that it has written.

    What went wrong first is raised by `check`, and when the block ends, whatever HDF5 says then.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x+")
        self._failed: OSError | None = None

    def check(self) -> None:
        """Raise what went wrong."""
        if self._failed is not None:
            raise self._failed

    def __exit__(self, *_: object) -> None:
        self.close()
        self.check()

    def write(self, data: Any) -> int:
        """Write all, or nothing any more."""
        left = memoryview(data)
        try:
            while left and self._failed is None:
                left = left[super().write(left) :]
        except OSError as error:
            self._failed = error
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Make it so long, unless that fails."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._failed = self._failed or error
            return self.tell()


def _write_hdf5(content: Content, lengths: Mapping[str, int], file: _Enduring) -> None:
    import h5netcdf
    import h5py

    attributes = _known({
        "NX_class": "NXdata",
        "signal": next(iter(content.variables)),
        "axes": list(content.axes),
        "Conventions": "CF-1.11",
        "schema": sealed_text(content.schema),
        "software": software(),
        **content.attributes,
    })  # fmt: skip
    with h5netcdf.File(file, "w", libver=_LIBVER) as made:
        made.attrs.update({**attributes, "NX_class": "NXroot", "default": "entry"})
        entry = made.create_group("entry")
        entry.attrs.update({"NX_class": "NXentry", "default": "data"})
        data = entry.create_group("data")
        data.attrs.update(attributes)
        data.dimensions = lengths
        for name, variable in content.variables.items():
            _write_variable(data, name, variable)
    file.check()
    with h5py.File(file, "r+", libver=_LIBVER) as opened:
        for name, item in opened[GROUP].items():  # dimensions without variables as well
            opened[name] = item  # a second name, not a second copy
    file.check()


def pixel_centres(shape: tuple[int, int]) -> dict[str, Variable]:
    """Return the coordinates of the dimensions row and col: pixel centres at integers."""
    return {
        axis: measured((axis,), np.arange(float(length)), "pixel", f"pixel centre along {axis}s")
        for axis, length in zip(("row", "col"), shape, strict=True)
    }


def flag_attributes(meaning: str) -> dict[str, Any]:
    """Return the attributes of flags (CF) whose bit 0 has a meaning."""
    masks = np.asarray([1], dtype=np.uint8)
    return {"long_name": "quality flags", "flag_masks": masks, "flag_meanings": meaning}


def to_json(value: Mapping[str, Any], field_name: str) -> str:
    """Return text and numbers as JSON; NumPy values become plain ones."""
    try:
        return json.dumps(dict(value), default=_plain)
    except (TypeError, ValueError, RecursionError) as error:
        raise DataError(f"expected text and numbers only: {error}", field=field_name) from error


def sealed_text(text: str) -> NDArray[np.bytes_]:
    """Return text of fixed length, for the attributes that this program reads back.

    HDF5 keeps it in a checksummed header. Text of variable length lies in a heap without a
    checksum, where a flipped bit can make HDF5 search for ever.
    """
    import h5py

    encoded = text.encode()
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def check_storable(name: str, values: NDArray[Any] | Allocated) -> None:
    """Raise a DataError unless every reader knows numbers of this kind."""
    if f"{values.dtype.kind}{values.dtype.itemsize}" not in _STORABLE:
        raise DataError(
            f"cannot store dtype {values.dtype}; convert it to an integer, float32, float64 or "
            "complex type first",
            field=name,
        )


def _dimension_lengths(variables: Mapping[str, Variable]) -> dict[str, int]:
    lengths: dict[str, int] = {}
    for name, variable in variables.items():
        values = variable.values
        check_storable(name, values)
        if len(variable.dims) != values.ndim:
            raise DataError(f"expected {variable.dims}, got shape {values.shape}", field=name)
        for dim, length in zip(variable.dims, values.shape, strict=True):
            if lengths.setdefault(dim, length) != length:
                raise DataError(
                    f"expected {lengths[dim]} along {dim}, got shape {values.shape}", field=name
                )
    return lengths


def _known(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in attributes.items() if value is not None}


def _write_variable(data: Any, name: str, variable: Variable) -> None:
    values = variable.values
    if isinstance(values, Allocated) and not values.packed:
        written = data.create_variable(name, variable.dims, values.dtype)
        written[(-1,) * values.ndim] = 0  # takes all the space
    else:
        dtype = values.dtype.newbyteorder("=")
        compression = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        chunks = _chunk_shape(values.shape, dtype.itemsize)
        filled = None if isinstance(values, Allocated) else values.astype(dtype, copy=False)
        written = data.create_variable(
            name, variable.dims, dtype, data=filled, chunks=chunks, fletcher32=True,
            **(compression if values.ndim > 1 else {}),
        )  # fmt: skip
    written.attrs.update(_known(variable.attributes))


def _chunk_shape(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return the chunk of about `CHUNK_BYTES` that cuts the leading dimensions first."""
    left = max(1, CHUNK_BYTES // itemsize)
    chunk: list[int] = []
    for length in reversed(shape):
        chunk.append(max(1, min(length, left)))
        left = max(1, left // length)
    return tuple(reversed(chunk))


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Path):
        return str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {name: getattr(value, name) for name in value.__dataclass_fields__}
    raise TypeError(f"a {type(value).__name__} cannot be stored")


def software() -> str:
    """Return the name and the version of this program."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"lensshift {version('lensshift')}"
    except PackageNotFoundError:
        return "lensshift (not installed)"
