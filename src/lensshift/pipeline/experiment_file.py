"""Experiments as TOML files; `four_boxes.toml` beside this module shows all tables."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.camera import (
    Ambient,
    Drift,
    LensOptics,
    Multipath,
    Scatter,
    TofCamera,
    camera_preset,
    named_pattern_px,
)
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.pipeline.experiment import Experiment
from lensshift.scene import (
    Scene,
    four_boxes,
    load_scene,
    siemens_star_card,
    slanted_depth_step,
    slanted_edge_card,
    zone_plate_card,
)

SCENES: dict[str, Callable[[], Scene]] = {
    "four_boxes": four_boxes,
    "slanted_edge": slanted_edge_card,
    "depth_step": slanted_depth_step,
    "siemens_star": siemens_star_card,
    "zone_plate": zone_plate_card,
}
# Groups of a camera that may be missing, and what a table of them becomes.
_EFFECTS: dict[str, type[Any]] = {
    "ambient": Ambient, "scatter": Scatter, "multipath": Multipath, "drift": Drift,
}  # fmt: skip
_GROUPS = ("illumination", "optics", "pixels", "readout", "validity")
_KEYS = {
    "": ("name", "scene", "camera", "burst", "reconstruction"),
    "scene": ("name", "file"),
    "camera": ("preset", "output", "lens", "grid", *_GROUPS, *_EFFECTS),
    "camera.lens": ("name", "file", "element", "transmission", "diffraction"),
    "camera.grid": ("shape", "pitch_mm"),
    "burst": ("pattern", "offset_px", "shift_error_px", "seed"),
    "reconstruction": ("scale", "method", "channel", "shifts", "psf_sigma_px"),
}
_Table = Mapping[str, Any]


def default_experiment() -> Experiment:
    """Return the experiment that comes with the package: four boxes before an O3M151."""
    return parse_experiment(default_text(), source="four_boxes.toml", folder=Path())


def default_text() -> str:
    """Return the file of `default_experiment`."""
    return (resources.files("lensshift.pipeline") / "four_boxes.toml").read_text(encoding="utf-8")


def load_experiment(path: str | Path) -> Experiment:
    """Read an experiment from a TOML file.

    Raises
    ------
    DataError
        If the file is missing, is not TOML, or does not describe an experiment: with file and
        field.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is not UTF-8 text"
        raise DataError(f"cannot be read: {reason}", source=path) from error
    return parse_experiment(text, source=str(path), folder=path.parent)


def parse_experiment(text: str, *, source: str, folder: Path) -> Experiment:
    """Return the experiment that a TOML text describes.

    Parameters
    ----------
    source : name of the file, for messages
    folder : that file names in it are relative to

    Raises
    ------
    DataError
        As in `load_experiment`.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"is not TOML: {error}", source=source) from error
    _check_keys(table, "", source)
    burst = _table(table, "burst", source)
    reconstruction = dict(_table(table, "reconstruction", source))

    def build() -> Experiment:
        return Experiment(
            scene=_scene(_table(table, "scene", source), source, folder),
            camera=_camera(_table(table, "camera", source), source, folder),
            pattern_px=_pattern(burst),
            shift_error_px=float(burst.get("shift_error_px", 0.02)),
            seed=_whole(burst.get("seed", 0), "seed"),
            name=str(table.get("name", "")),
            **{
                key: reconstruction[key] for key in _KEYS["reconstruction"] if key in reconstruction
            },
        )

    return _explained(build, source)


def named_scene(name: str) -> Scene:
    """Return a scene that comes with the package, by its name, or read it from a file.

    Raises
    ------
    DataError
        If there is neither such a scene nor such a file.
    """
    if name in SCENES:
        return SCENES[name]()
    if not Path(name).exists():
        raise DataError(f"expected a scene file or one of {', '.join(SCENES)}", source=name)
    return load_scene(name)


def named_optics(name: str, element: int, **options: Any) -> LensOptics:
    """Return a traced lens by its name or file; `element` from 1, 0 for a sensor that moves."""
    from lensshift.optics.lens_file import load_lens

    return LensOptics(load_lens(name), element=element - 1 if element > 0 else None, **options)


def _scene(table: _Table, source: str, folder: Path) -> Scene:
    if "file" in table:
        return load_scene(folder / str(table["file"]))
    name = table.get("name", "four_boxes")
    if name not in SCENES:
        raise DataError(
            f"expected one of {', '.join(SCENES)}, got {name!r}", source=source, field="scene.name"
        )
    return SCENES[name]()


def _camera(table: _Table, source: str, folder: Path) -> TofCamera:
    camera = camera_preset(table.get("preset", "o3m151"))
    changes: dict[str, Any] = {}
    if "output" in table:
        changes["output"] = table["output"]
    if "grid" in table:
        grid = _table(table, "grid", source, "camera.grid")
        rows, cols = grid.get("shape", camera.grid.shape)
        row_mm, col_mm = grid.get("pitch_mm", camera.grid.pitch_mm)
        changes["grid"] = Grid((int(rows), int(cols)), (float(row_mm), float(col_mm)))
    for name in _GROUPS:
        if name in table:
            group = getattr(camera, name)
            changes[name] = replace(group, **_fields(table, name, type(group), source))
    for name, kind in _EFFECTS.items():
        if name in table:
            changes[name] = kind(**_fields(table, name, kind, source))
    if "lens" in table:
        changes["optics"] = _lens(_table(table, "lens", source, "camera.lens"), folder)
    return replace(camera, **changes)


def _lens(table: _Table, folder: Path) -> LensOptics:
    options = {key: table[key] for key in ("transmission", "diffraction") if key in table}
    name = str(folder / str(table["file"])) if "file" in table else table.get("name", "petzval_a")
    return named_optics(name, _whole(table.get("element", 1), "camera.lens.element"), **options)


def _pattern(table: _Table) -> Any:
    if "offset_px" in table:
        return np.asarray(table["offset_px"], dtype=np.float64)
    return named_pattern_px(table.get("pattern", "square"))


def _fields(table: _Table, name: str, kind: type[Any], source: str) -> dict[str, Any]:
    """Return the fields of a group, with lists as tuples."""
    group = _table(table, name, source, f"camera.{name}")
    known = [field.name for field in fields(kind)]
    for key in group:
        if key not in known:
            raise DataError(
                f"is not known, expected {', '.join(known)}", source=source,
                field=f"camera.{name}.{key}",
            )  # fmt: skip
    return {key: tuple(value) if isinstance(value, list) else value for key, value in group.items()}


def _table(table: _Table, key: str, source: str, path: str | None = None) -> _Table:
    """Return a table within a table, with only known keys in it, or an empty one."""
    path = path or key
    inner = table.get(key, {})
    if not isinstance(inner, Mapping):
        raise DataError(f"expected a table, got {inner!r}", source=source, field=path)
    if path in _KEYS:
        _check_keys(inner, path, source)
    return inner


def _check_keys(table: _Table, path: str, source: str) -> None:
    for key in table:
        if key not in _KEYS[path]:
            raise DataError(
                f"is not known, expected {', '.join(_KEYS[path])}",
                source=source,
                field=f"{path}.{key}".lstrip("."),
            )


def _whole(value: object, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"expected a whole {name} of at least 0, got {value!r}")
    return value


def _explained(build: Callable[[], Experiment], source: str) -> Experiment:
    """Say in which file it was that a setting did not fit."""
    try:
        return build()
    except DataError:
        raise
    except (ValueError, TypeError) as error:
        raise DataError(str(error), source=source) from error
