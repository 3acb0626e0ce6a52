"""Read the container of bursts and results; damage becomes a `DataError`, never bad numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, naming
from lensshift.core.settings import parse_json
from lensshift.io.container_writer import GROUP
from lensshift.io.reading import check_held, check_unpacked, reading, require_file

WRITTEN = "written"  # of `io.sequence_file`
OTHERS = (
    "load_image_stack reads images, and arrays of other programs from NPZ and HDF5: amplitude, "
    "distance_m, valid ..."
)
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SIGNATURE_AT = (0, 512)  # behind a block of the program's own, as MATLAB writes it


@dataclass(frozen=True, slots=True, eq=False)
class Container:
    """An open file; every access names file and field if it fails."""

    path: Path
    group: Any  # `entry/data` of the file
    unpacked: list[int] = field(default_factory=list)  # bytes that each array read so far has taken

    def has(self, name: str) -> bool:
        """Tell whether the file has a variable of this name."""
        with reading(self.path, name):
            return _member(self.group, name) is not None

    def names(self) -> list[str]:
        """Return the names of all variables, those of dimensions included."""
        with reading(self.path):
            return sorted(self.group)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a variable without reading it."""
        with reading(self.path, name):
            item = _member(self.group, name)
            return tuple(getattr(item, "shape", None) or ())

    def array(
        self,
        name: str,
        *,
        kinds: str = "uifc",
        part: tuple[slice, ...] = (),
        shape: tuple[int, ...] | None = None,
    ) -> NDArray[Any]:
        """Read a variable of one of the given kinds (and shape), or a part of it."""
        import h5py

        with reading(self.path, name):
            item = _member(self.group, name)
            if not isinstance(item, h5py.Dataset):
                raise DataError("the variable is missing", field=name)
            if item.external or item.is_virtual:
                raise DataError("expected its own values, got those of other files", field=name)
            if item.dtype.kind not in kinds:
                raise DataError(f"expected numbers, got dtype {item.dtype}", field=name)
            if item.shape is None or item.size == 0:
                raise DataError(f"expected values, got shape {item.shape}", field=name)
            if shape not in (None, item.shape):
                raise DataError(f"expected shape {shape}, got {item.shape}", field=name)
            check_held(item.shape, item.nbytes, item.id.get_storage_size(), name)
            chunk_bytes = math.prod(item.chunks or (0,)) * item.dtype.itemsize
            taken = [chunk_bytes] if part else self.unpacked
            if not part:
                self.unpacked.append(max(item.nbytes, chunk_bytes))
            check_unpacked(sum(taken), self.path.stat().st_size, name)
            values = np.asarray(item[part or ()])
            return values.astype(values.dtype.newbyteorder("="), copy=False)

    def known(self, name: str, **options: Any) -> NDArray[Any] | None:
        """Read a variable as `array` does; None if there is none."""
        return self.array(name, **options) if self.has(name) else None

    def start_of(self, name: str) -> int:
        """Return where in the file the bytes of a variable begin that lie in one run."""
        with reading(self.path, name):
            start = _member(self.group, name).id.get_offset()
            if start is None:
                raise DataError("expected one run of bytes", field=name)
            return int(start)

    def written(self) -> NDArray[np.bool_] | None:
        """Return which pieces [piece] of a file that is filled piece by piece are there."""
        there = self.known(WRITTEN, kinds="ui")
        return None if there is None else there != 0

    def refuse_unfinished(self, piece: str, number: int | None = None) -> None:
        """Raise a `DataError` if a piece (or the one of that number) was not written.

        Space that was not filled holds zeros, which look like numbers that were measured.
        """
        there = self.written()
        if there is None or (there.all() if number is None else there[number]):
            return
        said = f"{there.sum()} of {there.size} {piece}s were written before it was broken off"
        one = "" if number is None else f"there is no {piece} {number} yet: "
        cure = "the same call as before goes on with it"
        raise DataError(f"{one}{said}; {cure}", source=self.path)

    def pairs(self, name: str, *, part: tuple[slice, ...] = ()) -> NDArray[np.float64]:
        """Read `name_row` and `name_col`, one number a frame each, as [frame 2]."""
        columns = [self.array(f"{name}_{axis}", kinds="uif", part=part) for axis in ("row", "col")]
        if columns[0].ndim != 1 or columns[0].shape != columns[1].shape:
            raise DataError(
                f"expected one number a frame like {name}_row, got shapes "
                f"{columns[0].shape} and {columns[1].shape}",
                field=f"{name}_col",
                source=self.path,
            )
        return np.stack(columns, axis=1).astype(np.float64)

    def attribute(self, name: str, *, of: str = "") -> Any:
        """Return an attribute of the set or of a variable, or None if it is absent."""
        label = f"{of}@{name}" if of else name
        with reading(self.path, label):
            owner = _member(self.group, of) if of else self.group
            if owner is None or name not in owner.attrs:
                return None
            value = owner.attrs[name]
            return value.decode() if isinstance(value, bytes) else value

    def text(self, name: str, *, of: str = "") -> str:
        """Return a text attribute."""
        value = self.attribute(name, of=of)
        if isinstance(value, str):
            return value
        raise self._unexpected("text", value, name)

    def number(self, name: str, *, of: str = "") -> float | None:
        """Return a numeric attribute, or None if it is absent."""
        value = self.attribute(name, of=of)
        return None if value is None else self._numbers(value, 1, name)[0]

    def numbers(self, name: str) -> list[float] | None:
        """Return a numeric attribute of one value or several, or None if it is absent."""
        value = self.attribute(name)
        return None if value is None else self._numbers(value, max(np.size(value), 1), name)

    def number_pair(self, name: str) -> tuple[float, float]:
        """Return a numeric attribute of two values, (row, col)."""
        row, col = self._numbers(self.attribute(name), 2, name)
        return row, col

    def mapping(self, name: str, *, of: str = "") -> dict[str, Any]:
        """Return the mapping that an attribute holds as JSON text; empty if it is absent."""
        if self.attribute(name, of=of) is None:
            return {}
        return parse_json(self.text(name, of=of), self.path, name)

    def _numbers(self, value: Any, count: int, name: str) -> list[float]:
        array = np.asarray(value)
        if array.dtype.kind not in "uif" or array.size != count:
            raise self._unexpected(f"{count} number(s)", value, name)
        return [float(number) for number in array.ravel()]

    def _unexpected(self, expected: str, value: Any, name: str) -> DataError:
        got = "the attribute is missing" if value is None else f"got {value!r:.80}"
        return DataError(f"expected {expected}, {got}", field=name, source=self.path)


def _member(group: Any, name: str) -> Any:
    """Return a member that lies in the file itself, or None.

    HDF5 follows a link wherever it leads: to another file, whose content would come back as
    measured, or to a pipe, which never ends. So links are looked at before anything is opened.
    """
    import h5py

    link = group.get(name, getlink=True)
    if link is None:
        return None
    if not isinstance(link, h5py.HardLink):
        raise DataError("expected the values themselves, got a link", field=name)
    return group[name]


@contextmanager
def open_container(path: str | Path, schema: str) -> Iterator[Container]:
    """Open a file that follows the schema or an older one; a `DataError` gets the name of it."""
    name, _, newest = schema.rpartition("/")
    with opened(Path(path)) as container:
        declared = container.text("schema")
        found = re.fullmatch(rf"{re.escape(name)}/([1-9][0-9]{{0,3}})", declared)
        if found is None:
            kind = re.match("lensshift-(burst|reconstruction|lens-field)/", declared)
            cure = f"; load_{kind[1].replace('-', '_')} reads it" if kind else ""
            problem = f"expected a file of schema {schema}, got {declared!r:.80}{cure}"
            raise DataError(problem, field="schema", source=path)
        if int(found[1]) > int(newest):
            problem = (
                f"got {declared!r:.80}, but this program reads up to {schema}; update lensshift"
            )
            raise DataError(problem, field="schema", source=path)
        with naming(path):
            yield container


def read_schema(path: str | Path) -> str:
    """Return the schema that a file declares, as in "lensshift-burst/1"."""
    with opened(Path(path)) as container:
        return container.text("schema")


def is_hdf5(path: str | Path) -> bool:
    """Tell whether a file starts like an HDF5 file, MATLAB's with its own 512 bytes before."""
    require_file(path)
    with reading(path), Path(path).open("rb") as file:
        start = file.read(_SIGNATURE_AT[-1] + len(_HDF5_SIGNATURE))
    return any(start.startswith(_HDF5_SIGNATURE, place) for place in _SIGNATURE_AT)


def is_ours(path: str | Path) -> bool:
    """Tell whether a file is an HDF5 file of this package, and not of another program."""
    if not is_hdf5(path):
        return False
    with reading(path), opened(Path(path), whole=True) as root:
        group = _ours(root.group)
        return group is not None and "schema" in group.attrs


def _ours(file: Any) -> Any:
    """Return the group of our variables, or the file itself where xarray wrote them; or None."""
    if "entry" not in file and str(file.attrs.get("schema")).startswith("lensshift-"):
        return file
    for name in GROUP.split("/"):
        file = _member(file, name) if hasattr(file, "keys") else None
    return file if hasattr(file, "keys") else None


@contextmanager
def opened(path: Path, *, whole: bool = False) -> Iterator[Container]:
    """Open an HDF5 file, the group of our variables or the whole."""
    import h5py

    if not is_hdf5(path):
        raise DataError(f"not a netCDF-4/HDF5 file; {OTHERS}", source=path)
    with reading(path):
        file = h5py.File(path, "r")
    try:
        with reading(path, GROUP):
            group = file if whole else _ours(file)
            if group is None:
                problem = "the group is missing; not a file of lensshift"
                raise DataError(f"{problem}; {OTHERS}", field=GROUP)
        yield Container(path, group)
    finally:
        with reading(path):
            file.close()
