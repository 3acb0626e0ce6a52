"""Containers larger than memory: allocated at once, filled piece by piece, whole at the end.

Until then the file is called NAME.part. Arrays that are filled lie in one run of bytes each, whose
place is known once the file is made, so filling them is plain writing: HDF5, which a kill in the
middle would leave damaged, is not open meanwhile. The variable `written` says which pieces are
there; what was begun with the same settings is gone on with.
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
from lensshift.io import container_writer as writer
from lensshift.io.capture_file import lock
from lensshift.io.container_reader import WRITTEN, open_container


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
        """Allocate a file, or go on with what was `begun` with the same text.

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
                problem = (
                    f"{part.name} was begun with other settings or of another recording; give "
                    "those, choose another name, or remove it"
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
