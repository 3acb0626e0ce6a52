"""Arrays of numbers by name, as other programs write them: NPZ, HDF5, netCDF-4 and MATLAB."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, warn_quality
from lensshift.io.container_reader import is_hdf5, opened
from lensshift.io.matlab_file import load_matlab
from lensshift.io.reading import check_unpacked, reading, require_file, unpacked_bytes

_MATLAB_COMPLEX = ("real", "imag")
_PACKED = {"scale_factor": 1.0, "add_offset": 0.0}  # attributes of netCDF, and what they are else


def has_names(path: str | Path) -> bool:
    """Tell whether arrays have names in a file."""
    return Path(path).suffix.lower() in (".npz", ".mat") or (Path(path).is_file() and is_hdf5(path))


def load_named_arrays(
    path: str | Path, attributes: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """Read the arrays of numbers and text of an NPZ file, or of numbers of an HDF5 or MAT file.

    Warns of Python objects in NPZ. In HDF5 packed numbers are unpacked and fill values are NaN, as
    netCDF has them; arrays are named without their groups if that is one name each, and numbers in
    `attributes` of the file count, too. Coordinates along dimensions, and links, are left out.

    Raises
    ------
    DataError
        If the file is damaged or holds no array.
    """
    require_file(path)
    if is_hdf5(path):
        return _hdf5_arrays(Path(path), attributes)
    with reading(path):
        if Path(path).suffix.lower() == ".mat":
            return load_matlab(Path(path))
        if not is_zipfile(path):
            raise DataError("not an NPZ file")
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
            check_unpacked(unpacked_bytes(archive), Path(path).stat().st_size, "")
            found = {name: _without_pickles(archive, name) for name in archive.files}
    arrays = {name: values for name, values in found.items() if values is not None}
    if left := ", ".join(name for name in found if name not in arrays):
        said = f"{left}: Python objects are not read; save arrays of numbers, text as JSON"
        if not arrays:
            raise DataError(said, source=path)
        warn_quality(f"{path}: {said}")
    return arrays


def chosen(names: Collection[str], key: str | None, likely: Sequence[str], path: Path) -> str:
    """Return the name of the array that is asked for, else the only likely one; or a DataError."""
    candidates = likely if key is None else [key]
    if len(candidates) == 1 and candidates[0] in names:
        return candidates[0]
    wanted = "the images" if key is None else repr(key)
    problem = f"cannot tell which array holds {wanted}; choose a key among {', '.join(names)}"
    raise DataError(problem, field="key", source=path)


def _without_pickles(archive: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any] | None:
    """Return an array, None for one of Python objects, which could run anything."""
    with reading("", name):
        try:
            values = archive[name]
        except ValueError as error:
            if "Object arrays" in str(error):
                return None
            raise
        if not isinstance(values, np.ndarray):
            raise DataError("expected an array", field=name)
        return values


def _hdf5_arrays(path: Path, attributes: Collection[str]) -> dict[str, NDArray[Any]]:
    import h5py

    items: dict[str, Any] = {}
    with opened(path, whole=True) as root, reading(path):
        root.group.visititems(lambda name, item: items.update({name: item}))  # follows no link
        items = {
            name: item
            for name, item in items.items()
            if isinstance(item, h5py.Dataset) and item.size
            if item.dtype.kind in "biufc" or item.dtype.names == _MATLAB_COMPLEX
            if item.attrs.get("MATLAB_class") != b"char"
            if item.attrs.get("CLASS") != b"DIMENSION_SCALE"
        }
        short = [name.rpartition("/")[2] for name in items]
        told = {name: np.asarray(root.attribute(name)) for name in attributes}
        numbers = {name: one for name, one in told.items() if one.dtype.kind in "uif"}
        for (name, item), last in zip(items.items(), short, strict=True):
            values = replace(root, group=item.parent).array(last, kinds="biufcV")
            numbers[last if short.count(last) == 1 else name] = _measured(values, item)
    if not numbers:
        raise DataError("there is no array of numbers in it", source=path)
    return numbers


def _measured(values: NDArray[Any], item: Any) -> NDArray[Any]:
    """Return what the numbers of a variable stand for, NaN where there is none."""
    told = {name: np.ravel(item.attrs[name]) for name in item.attrs if name != "REFERENCE_LIST"}
    if values.dtype.names:
        values = values["real"] + 1j * values["imag"]
    if "MATLAB_class" in told:  # which counts axes from the one that runs fastest
        values = values.T
    scale, offset = (float(told.get(name, [n])[0]) for name, n in _PACKED.items())
    empty = [told[name] for name in ("_FillValue", "missing_value") if name in told]
    if not empty and (scale, offset) == (1.0, 0.0):
        return values
    return np.where(np.isin(values, np.concatenate([[], *empty])), np.nan, values * scale + offset)
