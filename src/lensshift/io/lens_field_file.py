"""Lens fields as files: coefficients and what they belong to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lensshift.core.errors import about
from lensshift.core.grid import Grid
from lensshift.core.lens_field import LensField
from lensshift.io import container_writer as writer
from lensshift.io.container_reader import open_container

SCHEMA = "lensshift-lens-field/1"
_NUMBERS = ("shift_error_px", "spot_error_px", "contrast_error")
_COEFFICIENTS = {
    "shift": ("shift_px", "pixel", "Chebyshev coefficients of the image offset"),
    "spot": ("spot_px2", "pixel2", "Chebyshev coefficients of variances, covariance of the spot"),
    "skew": ("skew_px3", "pixel3", "Chebyshev coefficients of the third moment of the spot"),
}


def save_lens_field(field: LensField, path: str | Path) -> None:
    """Write a lens field to a netCDF file, whole or not at all.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    variables: dict[str, writer.Variable] = {}
    for name, (own, units, meaning) in _COEFFICIENTS.items():
        if getattr(field, own) is None:
            continue
        last = "moment" if name == "spot" else "axis"
        dims = *(f"{name}_{axis}" for axis in ("row", "col", "state_row", "state_col")), last
        variables[name] = writer.measured(dims, getattr(field, own), units, meaning)
    attributes = {
        "shape": np.asarray(field.grid.shape, dtype=np.int64),
        "pitch_mm": np.asarray(field.grid.pitch_mm, dtype=np.float64),
        "reach": np.asarray(field.reach, dtype=np.float64),
        "motion": writer.sealed_text(field.motion),
        "element": None if field.element is None else np.int64(field.element + 1),
        "lens": writer.sealed_text(writer.to_json({"name": field.lens}, "lens")),
        "notes": writer.sealed_text(writer.to_json(field.notes or {}, "notes")),
        **{name: np.float64(getattr(field, name)) for name in _NUMBERS},
    }
    writer.write_container(
        writer.Content(SCHEMA, variables["shift"].dims, variables, attributes), path
    )


def load_lens_field(path: str | Path) -> LensField:
    """Read a lens field.

    Raises
    ------
    DataError
        If the file is missing, damaged, no lens field, or contradicts itself; the message names
        the file and the field.
    """
    with open_container(path, SCHEMA) as container:
        rows, cols = container.number_pair("shape")
        element = container.number("element")
        values: dict[str, Any] = {
            own: container.array(name, kinds="f")
            for name, (own, *_) in _COEFFICIENTS.items()
            if name != "skew" or container.has(name)
        }
        values |= {name: container.number(name) or 0.0 for name in _NUMBERS}
        pitch_mm = container.number_pair("pitch_mm")
        with about("shape"):
            grid = Grid((int(rows), int(cols)), pitch_mm)
        return LensField(
            grid=grid,
            reach=container.number_pair("reach"),
            motion=container.text("motion"),  # type: ignore[arg-type]  # checked there
            element=None if element is None else int(element) - 1,
            lens=str(container.mapping("lens").get("name", "")),
            notes=container.mapping("notes"),
            **values,
        )
