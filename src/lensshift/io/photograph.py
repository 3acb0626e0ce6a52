"""Photographs, grey or in colour: JPEG, PNG, TIFF."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.core.settings import read_text
from lensshift.io import image_file
from lensshift.io.reading import check_unpacked, reading, require_file

PHOTOGRAPH_SUFFIXES = (*image_file.JPEG_SUFFIXES, ".png", *image_file.TIFF_SUFFIXES)
_COLOURS = 3  # red, green, blue


def load_photograph(path: str | Path, *, frame: int = 0) -> NDArray[Any]:
    """Read one picture [row col], or [row col 3] if its colours differ, of .jpg, .png or .tif.

    It is turned as a viewer shows it, by the orientation of EXIF.
    """
    require_file(path)
    suffix = Path(path).suffix.lower()
    with reading(path):
        values = _colour_tiff(path, frame) if suffix in image_file.TIFF_SUFFIXES else None
        if values is None:
            pillow = suffix in (*image_file.JPEG_SUFFIXES, ".png")
            pages = (image_file.load_pages if pillow else image_file.load_frames)(path)
            _check_frame(frame, len(pages))
            values = image_file.upright(pages[frame], image_file.orientation(path))
    if values.ndim == 3:
        values = values[..., : _COLOURS if values.shape[2] > 2 else 1]
    grey = values.ndim == 3 and bool(np.all(values == values[..., :1]))
    return values[..., 0] if grey else values


def load_jpeg_steps(path: str | Path) -> NDArray[np.float64] | None:
    """Read the quantisation table [8 8] (row, col) of the luminance of a JPEG; None of others.

    Rows are those of the picture as `load_photograph` turns it.
    """
    require_file(path)
    if Path(path).suffix.lower() not in image_file.JPEG_SUFFIXES:
        return None
    with reading(path), image_file.opened_by_pillow(path, "JPEG") as image:
        table = image.quantization.get(0)
    if table is None:
        return None
    steps = np.array(table, dtype=np.float64).reshape(8, 8)
    return steps.T if image_file.orientation(path) > 4 else steps


def load_oecf(path: str | Path) -> NDArray[np.float64]:
    """Read level and light [n 2] from a CSV file, with a header or not; or a DataError."""
    rows = []
    for number, row in enumerate(csv.reader(read_text(path).splitlines()), start=1):
        if not row:
            continue
        try:
            level, light = (float(one) for one in row)
        except ValueError as error:
            if number == 1:
                continue
            problem = f"line {number}: expected level,light, got {','.join(row)!r:.60}"
            raise DataError(problem, source=path) from error
        rows.append((level, light))
    if len(rows) < 2:
        raise DataError("expected two lines of level,light or more", source=path)
    return np.array(rows)


def _check_frame(frame: int, count: int) -> None:
    if not 0 <= frame < count:
        expected = f"a frame from 0 to {count - 1}" if count > 1 else "frame 0, the only one"
        raise DataError(f"expected {expected}, got {frame}")


def _colour_tiff(path: str | Path, frame: int) -> NDArray[Any] | None:
    """Return [row col 3] of a page of a TIFF of colours, None if it is none or holds frames.

    tifffile stores three or four frames as planes of colours unasked: they are frames where another
    than the first is asked for, or where one of them would be a transparency.
    """
    import tifffile

    with image_file.strict_tifffile(), tifffile.TiffFile(path) as file:
        page: Any = file.pages.first
        series = file.series[0]
        if page.photometric != tifffile.PHOTOMETRIC.RGB:
            return None
        planes = series.axes == "SYX" and series.kind == "shaped"
        if planes and (frame > 0 or page.samplesperpixel > _COLOURS):
            return None
        _check_frame(frame, len(file.pages))
        page = file.pages[frame]
        if page.compression not in image_file.TIFFFILE_COMPRESSIONS:
            return image_file.load_pages(path)[frame][..., :_COLOURS]
        check_unpacked(page.nbytes, Path(path).stat().st_size, "pages")
        values = page.asarray()
        if "S" not in page.axes:
            return None
        return np.asarray(np.moveaxis(values, page.axes.index("S"), -1)[..., :_COLOURS])
