"""Experiments as TOML files; `four_boxes.toml` beside this module shows all tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
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
from lensshift.core.errors import DataError, about
from lensshift.core.settings import (
    built,
    fit,
    fitted,
    only,
    parse_toml,
    read_text,
    settings_of,
    table_of,
)
from lensshift.pipeline.experiment import Experiment
from lensshift.reconstruction.methods import find_method
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
_GROUPS = ("grid", "illumination", "optics", "pixels", "readout", "validity")
_TABLES = ("name", "scene", "camera", "burst", "reconstruction")
# Beside the options of the method.
_RECONSTRUCTION = ("scale", "method", "channel", "shifts", "psf_sigma_px")
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
    return parse_experiment(read_text(path), source=str(path), folder=path.parent)


def parse_experiment(text: str, *, source: str, folder: Path) -> Experiment:
    """Return the experiment of a TOML text, or a DataError; its paths are relative to `folder`."""
    table = parse_toml(text, source)
    with settings_of(source):
        only(table, _TABLES)
        reconstruction, options = _reconstruction(table_of(table, "reconstruction"))
        return Experiment(
            scene=_scene(table_of(table, "scene"), folder),
            camera=_camera(table_of(table, "camera"), folder),
            name=fit(table.get("name", ""), str, "name"),
            **_burst(table_of(table, "burst")),
            options=options,
            **fitted(Experiment, reconstruction, "reconstruction"),
        )


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


def _reconstruction(table: _Table) -> tuple[_Table, dict[str, Any]]:
    """Return the entries for an experiment, and the options of its method."""
    method = find_method(fit(table.get("method", "auto"), str, "reconstruction.method"))
    only(table, (*_RECONSTRUCTION, *method.option_names()), "reconstruction")
    options = _some(table, method.option_names())
    return _some(table, _RECONSTRUCTION), fitted(method, options, "reconstruction")


def _scene(table: _Table, folder: Path) -> Scene:
    only(table, ("name", "file"), "scene")
    if "file" in table:
        return load_scene(folder / fit(table["file"], str, "scene.file"))
    name = fit(table.get("name", "four_boxes"), str, "scene.name")
    if name not in SCENES:
        raise DataError(f"expected one of {', '.join(SCENES)}, got {name!r}", field="scene.name")
    return SCENES[name]()


def _camera(table: _Table, folder: Path) -> TofCamera:
    only(table, ("preset", "output", "lens", *_GROUPS, *_EFFECTS), "camera")
    preset = fit(table.get("preset", "o3m151"), str, "camera.preset")
    with about("camera.preset"):
        camera = camera_preset(preset)
    changes: dict[str, Any] = fitted(TofCamera, _some(table, ("output",)), "camera")
    for name in _GROUPS:
        if name in table:
            group, where = getattr(camera, name), f"camera.{name}"
            entries = fitted(type(group), table_of(table, name, "camera"), where)
            with about(where):
                changes[name] = replace(group, **entries)
    for name, kind in _EFFECTS.items():
        if name in table:
            changes[name] = built(kind, table_of(table, name, "camera"), f"camera.{name}")
    if "lens" in table:
        changes["optics"] = _lens(table_of(table, "lens", "camera"), folder)
    with about("camera"):
        return replace(camera, **changes)


def _lens(table: _Table, folder: Path) -> LensOptics:
    options = ("transmission", "diffraction")
    only(table, ("name", "file", "element", *options), "camera.lens")
    if "file" in table:
        name = str(folder / fit(table["file"], str, "camera.lens.file"))
    else:
        name = fit(table.get("name", "petzval_a"), str, "camera.lens.name")
    element = _count(table.get("element", 1), "camera.lens.element")
    return named_optics(name, element, **fitted(LensOptics, _some(table, options), "camera.lens"))


def _burst(table: _Table) -> dict[str, Any]:
    numbers = ("shift_error_px", "seed")
    only(table, ("pattern", "offset_px", *numbers), "burst")
    found = fitted(Experiment, _some(table, numbers), "burst")
    _count(found.get("seed", 0), "burst.seed")
    if "offset_px" in table:
        pairs = fit(table["offset_px"], tuple[tuple[float, float], ...], "burst.offset_px")
        return found | {"pattern_px": np.asarray(pairs, dtype=np.float64)}
    pattern = fit(table.get("pattern", "square"), str, "burst.pattern")
    return found | {"pattern_px": named_pattern_px(pattern)}


def _some(table: _Table, keys: Iterable[str]) -> dict[str, Any]:
    return {key: table[key] for key in keys if key in table}


def _count(value: Any, where: str) -> int:
    count: int = fit(value, int, where)
    if count < 0:
        raise DataError(f"expected at least 0, got {count}", field=where)
    return count
