"""Calibrations as JSON: readable, with a schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.core.atomic import write_text
from lensshift.core.calibration import PAIRS, WIDTHS, Calibration
from lensshift.core.errors import DataError
from lensshift.core.motion import StageMap
from lensshift.core.settings import fit, parse_json, read_text, settings_of

SCHEMA = "lensshift-calibration/1"
# Field -> its axes; a field is there, or may be null or missing.
_NEEDED = {"px_per_mm": 2, "sigma_px": 0, **dict.fromkeys(PAIRS, 1)}
_OPTIONAL = {"px_per_mm_sigma": 2, "field_px_per_mm": 4, **dict.fromkeys(WIDTHS, 0)}


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration as JSON, whole or not at all. DataError if the file cannot be written."""
    content = calibration_content(calibration)
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def calibration_content(calibration: Calibration) -> dict[str, Any]:
    """Return what a calibration file says: plain text, numbers and lists."""
    stage_map = calibration.stage_map
    content = {
        "schema": SCHEMA,
        "source": calibration.source,
        "px_per_mm": stage_map.px_per_mm,
        "px_per_mm_sigma": calibration.px_per_mm_sigma,
        "sigma_px": stage_map.sigma_px,
        **{name: getattr(calibration, name) for name in (*PAIRS, *WIDTHS)},
        "notes": dict(calibration.notes),
        "field_px_per_mm": stage_map.field_px_per_mm,
    }
    return {k: one.tolist() if isinstance(one, np.ndarray) else one for k, one in content.items()}


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration.

    DataError if the file is missing, is no calibration, or a field is missing or wrong.
    """
    content = parse_json(read_text(path), path)
    if content.get("schema") != SCHEMA:
        problem = f"expected {SCHEMA}, got {content.get('schema')!r:.60}"
        raise DataError(problem, field="schema", source=path)
    with settings_of(path):
        source, notes = content.get("source"), content.get("notes", {})
        if source not in ("nominal", "measured"):
            raise DataError(f"expected nominal or measured, got {source!r:.60}", field="source")
        if not isinstance(notes, dict):
            raise DataError("expected names and values", field="notes")
        known: dict[str, Any] = {name: _array(content, name, n) for name, n in _NEEDED.items()}
        known |= {
            name: None if content.get(name) is None else _array(content, name, axes)
            for name, axes in _OPTIONAL.items()
        }
        stage_map = [known.pop(name) for name in ("px_per_mm", "field_px_per_mm", "sigma_px")]
        return Calibration(StageMap(*stage_map), source=source, notes=notes, **known)


def _array(content: dict[str, Any], name: str, axes: int) -> Any:
    if name not in content:
        raise DataError("this field is missing", field=name)
    kind: Any = float
    for _ in range(axes):
        kind = tuple[kind, ...]
    values = fit(content[name], kind, name)
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except ValueError as error:
        raise DataError("expected rows of the same length", field=name) from error
    if not np.all(np.isfinite(numbers)):
        raise DataError("expected finite numbers", field=name)
    return numbers if axes else float(numbers)
