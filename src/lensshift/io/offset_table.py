"""Shifts of the frames from CSV and JSON."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.core.settings import built, parse_json, read_text
from lensshift.core.types import OffsetSource
from lensshift.io.reading import reading, require_file

_REQUIRED = ("row", "col")
_COLUMNS = ("frame", *_REQUIRED, "sigma_row", "sigma_col")


@dataclass(frozen=True, slots=True, eq=False)
class OffsetTable:
    """Where the content lies in each frame.

    Parameters
    ----------
    offset_px : [frame 2] (row, col); positive: the content moved down / right in that frame
    offset_sigma_px : [frame 2] standard deviation, or None
    offset_source : where the offsets come from
    """

    offset_px: NDArray[np.float64]
    offset_sigma_px: NDArray[np.float64] | None = None
    offset_source: OffsetSource = "planned"


def load_offsets(path: str | Path) -> OffsetTable:
    """Read shifts in LR pixels from a file.

    CSV: a header `row,col`, optionally with `frame` (from 0, in any order), `sigma_row` and
    `sigma_col`; one line a frame; lines that begin with # are skipped. Where the header has
    semicolons or tabs instead, numbers may have a decimal comma.
    JSON: `{"offset_px": [[row, col], ...]}`, optionally with `offset_sigma_px` and
    `offset_source`.

    Raises
    ------
    DataError
        If the file is missing or wrong; the message names the file and the line or field.
    """
    require_file(path)
    suffix = Path(path).suffix.lower()
    if suffix not in (".csv", ".txt", ".tsv", ".json"):
        raise DataError(f"expected shifts in a .csv or .json file, got {suffix!r}", source=path)
    with reading(path):
        text = read_text(path)
        return _from_json(text) if suffix == ".json" else _from_csv(text)


def _from_csv(text: str) -> OffsetTable:
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip(" \t;,") and not line.lstrip().startswith("#")
    ]
    first = numbered[0][1] if numbered else ""
    mark = next((mark for mark in ";\t" if mark in first), ",")
    lines = csv.reader((line for _, line in numbered), delimiter=mark, skipinitialspace=True)
    header = [name.strip().lower() for name in next(lines, [])]
    if header[:1] == [""]:  # as pandas writes the numbers of its rows
        header[0] = "frame"
    _check_header(header)
    rows: list[dict[str, float]] = []
    for cells, (number, _) in zip(lines, numbered[1:], strict=False):
        found = cells if mark == "," else [cell.replace(",", ".") for cell in cells]
        rows.append(_csv_row(header, found, f"line {number}"))
    if not rows:
        raise DataError("expected one line a frame below the header, got none", field="row")
    if "frame" in header:
        frames = [row["frame"] for row in rows]
        if sorted(frames) != list(range(len(rows))):
            raise DataError(
                f"expected each number from 0 to {len(rows) - 1} once, got "
                f"{', '.join(f'{frame:g}' for frame in frames)}",
                field="frame",
            )
        rows.sort(key=lambda row: row["frame"])
    offset_px = np.array([[row["row"], row["col"]] for row in rows])
    if "sigma_row" not in header:
        return OffsetTable(offset_px)
    return OffsetTable(offset_px, np.array([[row["sigma_row"], row["sigma_col"]] for row in rows]))


def _check_header(header: list[str]) -> None:
    unknown = [name for name in header if name not in _COLUMNS]
    missing = [name for name in _REQUIRED if name not in header]
    if unknown or missing or len(set(header)) != len(header):
        raise DataError(
            f"expected the header row,col (and perhaps frame, sigma_row, sigma_col), "
            f"got {','.join(header)!r:.80}; row: down, y; col: to the right, x",
            field="line 1",
        )
    if ("sigma_row" in header) != ("sigma_col" in header):
        raise DataError("expected sigma_row and sigma_col, got only one of them", field="line 1")


def _csv_row(header: list[str], cells: list[str], line: str) -> dict[str, float]:
    if len(cells) != len(header):
        raise DataError(f"expected {len(header)} values, got {len(cells)}", field=line)
    row: dict[str, float] = {}
    for name, cell in zip(header, cells, strict=True):
        try:
            row[name] = float(cell)
        except ValueError:
            row[name] = math.nan
        if not math.isfinite(row[name]):
            raise DataError(f"expected a finite number, got {cell!r:.40}", field=f"{line}, {name}")
    return row


@dataclass(frozen=True, slots=True)
class _Json:
    offset_px: tuple[tuple[float, float], ...]
    offset_sigma_px: tuple[tuple[float, float], ...] | None = None
    offset_source: OffsetSource = "planned"


def _from_json(text: str) -> OffsetTable:
    content = parse_json(text, field="offset_px")
    if not content.get("offset_px"):
        problem = 'expected {"offset_px": [[row, col], ...]}, a pair for each frame'
        raise DataError(problem, field="offset_px")
    told = built(_Json, content, "")
    sigma = told.offset_sigma_px
    sigma_px = None if sigma is None else _pairs(sigma, "offset_sigma_px")
    return OffsetTable(_pairs(told.offset_px, "offset_px"), sigma_px, told.offset_source)


def _pairs(found: tuple[tuple[float, float], ...], name: str) -> NDArray[np.float64]:
    pairs = np.array(found)
    if not np.all(np.isfinite(pairs)):
        raise DataError("expected finite numbers, got NaN or infinity", field=name)
    return pairs
