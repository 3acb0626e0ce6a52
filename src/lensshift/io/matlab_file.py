"""Arrays of numbers in MAT files of versions 5 to 7, what MATLAB and Octave write by default.

Newer files (version 7.3) are HDF5. SciPy's reader ends the whole process on damaged files.
Source: MAT-File Format, The MathWorks, R2024a.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.io.reading import check_unpacked

_HEADER = 128  # bytes, the last two of which tell the order of bytes
_MATRIX, _COMPRESSED = 14, 15
# Type of the bytes, which may be fewer than those of the class that they stand for.
_TYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_CLASSES = dict(enumerate(("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), 6))
_COMPLEX = 0x800  # among the flags


def load_matlab(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of numbers by name, axes as MATLAB has them; DataError if there is none."""
    whole = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(whole[_HEADER - 2 : _HEADER])
    if order is None:
        raise DataError("no MAT file of version 5 or newer; save(..., '-v7') writes one")
    arrays: dict[str, NDArray[Any]] = {}
    taken = 0
    for kind, content in _elements(whole[_HEADER:], order):
        if kind == _COMPRESSED:
            opened = zlib.decompressobj()
            size = int(np.frombuffer(opened.decompress(content, 8), f"{order}u4")[1])
            taken += size
            check_unpacked(taken, len(whole), "")
            content = opened.decompress(opened.unconsumed_tail, size)
            if len(content) < size:
                raise DataError("damaged or cut short (fewer bytes than it says)")
        elif kind != _MATRIX:
            continue
        name, values = _array(content, order)
        if name and values is not None and values.size:
            arrays[name] = values
    if not arrays:
        raise DataError("no array of numbers; of a struct s: save('x.mat', '-struct', 's')")
    return arrays


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and bytes of each element, which begin at multiples of 8."""
    place = 0
    while place < len(content):
        kind, count = np.frombuffer(content, f"{order}u4", 2, place).tolist()
        start = place + 8
        if kind >> 16:  # up to four bytes stand where others tell their number
            kind, count, start = kind & 0xFFFF, kind >> 16, place + 4
        if start + count > len(content):
            raise DataError("damaged or cut short (fewer bytes than it says)")
        yield kind, content[start : start + count]
        place = start + count + (-(start + count) % 8 if kind != _COMPRESSED else 0)


def _array(content: bytes, order: str) -> tuple[str, NDArray[Any] | None]:
    """Return name and values of an array; no values of what holds no numbers."""
    (_, flags), (_, shape), (_, name), *parts = _elements(content, order)
    told = int(np.frombuffer(flags, f"{order}u4")[0])
    dtype = _CLASSES.get(told & 0xFF)
    if dtype is None:
        return "", None
    both = [np.frombuffer(one, f"{order}{_TYPES[kind]}").astype(dtype) for kind, one in parts[:2]]
    values = both[0] + 1j * both[1] if told & _COMPLEX else both[0]
    sizes = np.frombuffer(shape, f"{order}i4").tolist()
    return name.decode("ascii"), values.reshape(sizes, order="F")
