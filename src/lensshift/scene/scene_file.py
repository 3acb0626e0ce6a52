"""Scene files in TOML: shapes and textures by the names of their fields.

    [[object]]
    shape = "cuboid"                  # plane, rectangle, cuboid, sphere, mesh
    centre_m = [0.0, 0.1, 3.5]
    turn_deg = [0.0, 30.0, 0.0]
    size_m = [0.2, 0.1, 0.1]
    reflectance = { texture = "checker", size_m = 0.02 }     # or a number

    [background]                      # at most one
    shape = "plane"
    centre_m = [0.0, 0.0, 4.0]

Angles are in degrees in the file. A mesh has `vertices_m` and `triangles`, or a `file` and its
`unit_m`; the texture "image" has an `image` or a grey `file`. Files lie relative to the scene file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, fields
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.atomic import write_text
from lensshift.core.errors import DataError, about, naming
from lensshift.core.settings import check_keys, fit, parse_toml, read_text
from lensshift.scene import textures
from lensshift.scene.checks import number, numbers
from lensshift.scene.mesh import Mesh, load_mesh
from lensshift.scene.shapes import Cuboid, Plane, Rectangle, Scene, Shape, Sphere

_SHAPES: dict[str, type[Shape]] = {
    "plane": Plane,
    "rectangle": Rectangle,
    "cuboid": Cuboid,
    "sphere": Sphere,
    "mesh": Mesh,
}
_TEXTURES: dict[str, Callable[..., Any]] = {
    "constant": textures.Constant,
    "checker": textures.Checker,
    "edge": textures.Edge,
    "siemens_star": textures.SiemensStar,
    "zone_plate": textures.ZonePlate,
    "line_pairs": textures.LinePairs,
    "image": textures.ImageTexture,
}
# What a file gives instead of numbers that are written out, and the keys that name the file.
_IN_FILE = {"mesh": {"vertices_m", "triangles"}, "image": {"image"}}
_FILE_KEYS = {"mesh": {"file", "unit_m"}, "image": {"file"}}
_Table = dict[str, Any]
_Built = TypeVar("_Built")


def load_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file; the module's docstring shows one.

    Raises
    ------
    DataError
        If a file is missing, is not TOML, or describes no scene: with file and field.
    ImportError
        If it names a mesh file and trimesh is not installed.
    """
    return parse_scene(read_text(path), source=path)


def parse_scene(text: str, source: str | Path = "") -> Scene:
    """Return the scene that a text in TOML describes; files lie relative to `source`."""
    content = parse_toml(text, source)
    with naming(source):
        return _scene(content, Path(source).parent)


def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene as TOML, so that `load_scene` returns the same scene.

    Meshes and images are written out in full.

    Raises
    ------
    TypeError
        If a shape or texture is not one of this package.
    DataError
        If the file cannot be written.
    """
    heads = ["[[object]]"] * len(scene.objects) + ["[background]"]
    tables = [
        [head, f'shape = "{_kind_of(shape, _SHAPES, "shape")}"', *_lines(shape)]
        for head, shape in zip(heads, scene.shapes, strict=False)
    ]
    write_text(path, "\n\n".join("\n".join(lines) for lines in tables) + "\n")


def _scene(content: dict[str, Any], folder: Path) -> Scene:
    unknown = sorted(set(content) - {"object", "background"})
    if unknown:
        raise DataError("expected [[object]] and [background]", field=unknown[0])
    if not content:
        raise DataError("expected at least one [[object]] or a [background], got neither")
    tables = content.get("object", [])
    if not isinstance(tables, list):
        raise DataError("expected tables headed [[object]]", field="object")
    objects = [_shape(table, f"object {n}", folder) for n, table in enumerate(tables, start=1)]
    background = content.get("background")
    return Scene(
        tuple(objects),
        background=None if background is None else _shape(background, "background", folder),
    )


def _shape(table: Any, where: str, folder: Path) -> Shape:
    if isinstance(table, dict) and table.get("name"):
        where = f"{where} ({table['name']})"
    kind, values = _values(table, "shape", _SHAPES, where)
    if isinstance(values.get("reflectance"), dict):
        values["reflectance"] = _texture(values["reflectance"], f"{where}, reflectance", folder)
    build: Callable[..., Shape] = _SHAPES[kind]
    if "file" in values:
        build = partial(load_mesh, _path(values.pop("file"), where, folder))
    return _built(build, values, where)


def _texture(table: _Table, where: str, folder: Path) -> textures.Texture:
    kind, values = _values(table, "texture", _TEXTURES, where)
    if "file" in values:
        path = _path(values.pop("file"), where, folder)
        values["image"] = _built(_grey_image, {"path": path}, where)
    build: Callable[..., textures.Texture] = _TEXTURES[kind]
    return _built(build, values, where)


def _values(table: Any, word: str, kinds: Mapping[str, Any], where: str) -> tuple[str, _Table]:
    """Return the kind of a table and its values by field, angles in radians."""
    if not isinstance(table, dict):
        raise DataError(f"expected a table, got {table!r}", field=where)
    kind = table.get(word)
    if not isinstance(kind, str) or kind not in kinds:
        raise DataError(f"expected {word} of {', '.join(kinds)}, got {kind!r}", field=where)
    own = fields(kinds[kind])
    keys = {one.name.replace("_rad", "_deg"): one.default is MISSING for one in own}
    if "file" in table and kind in _FILE_KEYS:
        keys = {key: needed for key, needed in keys.items() if key not in _IN_FILE[kind]}
        keys |= dict.fromkeys(_FILE_KEYS[kind], False)
    given = {key: value for key, value in table.items() if key != word}
    check_keys(given, keys, where)
    values, hints = {}, get_type_hints(kinds[kind])
    for key, value in given.items():
        name = key.replace("_deg", "_rad")
        if hints.get(name) in (bool, int, str):  # numbers are checked by whoever takes them
            fit(value, hints[name], f"{where}, {key}")
        with about(where):
            if key == "turn_deg":
                value = tuple(map(math.radians, numbers(key, value, 3)))
            elif key == "slant_deg":
                value = math.radians(number(key, value))
        values[name] = value
    return kind, values


def _built(build: Callable[..., _Built], values: _Table, where: str) -> _Built:
    """Return what `build` makes of the values; what it does not like is the file's mistake."""
    try:
        return build(**values)
    except (TypeError, ValueError) as error:
        raise DataError(str(error), field=where) from error


def _path(file: Any, where: str, folder: Path) -> Path:
    if not isinstance(file, str):
        raise DataError(f"expected the name of a file for file, got {file!r}", field=where)
    return folder / file


def _grey_image(path: Path) -> Floats:
    """Read a grey picture, 0 to 1 in proportion to its numbers."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            mode = picture.mode
            pixels = np.asarray(picture)
    except OSError as error:
        raise DataError(f"cannot read as a picture: {error}", source=path) from error
    if mode not in ("1", "L") and not mode.startswith("I;16"):
        raise DataError(f"expected a grey picture of 8 or 16 bits, got {mode}", source=path)
    top = 1 if pixels.dtype == np.bool_ else np.iinfo(pixels.dtype).max
    return pixels / float(top)


def _kind_of(value: Any, kinds: Mapping[str, Any], word: str) -> str:
    for kind, known in kinds.items():
        if type(value) is known:
            return kind
    raise TypeError(f"expected a {word} of {', '.join(kinds)}, got {type(value).__name__}")


def _lines(value: Any) -> Iterator[str]:
    """Yield one line for each field of a shape or texture that is not at its default."""
    for field in fields(value):
        content = getattr(value, field.name)
        if isinstance(content, np.ndarray) or content != field.default:
            yield f"{field.name.replace('_rad', '_deg')} = {_toml(field.name, content)}"


def _toml(name: str, value: Any) -> str:
    if name == "reflectance" and callable(value):
        kind = _kind_of(value, _TEXTURES, "texture")
        return "{ " + ", ".join([f'texture = "{kind}"', *_lines(value)]) + " }"
    if name.endswith("_rad"):
        value = np.degrees(value)
    # Texts, numbers, truths and lists are written in JSON as in TOML.
    return json.dumps(value.tolist() if hasattr(value, "tolist") else value, ensure_ascii=False)
