"""Settings from files: text, TOML, and values that fit the annotations of what they are for.

Messages name table and key, as in `acquisition.average: expected bool, got 'false'`. Whoever reads
a file adds its name (`DataError.in_file`).
"""

from __future__ import annotations

import inspect
import json
import math
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from itertools import repeat
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from lensshift.core.errors import DataError, about, naming

T = TypeVar("T")
_MAX_TEXT_BYTES = 1 << 26  # a table of a shift for every pixel has some 20 MB


def read_text(path: str | Path) -> str:
    """Return a text in UTF-8; a pipe, which might never end, is refused.

    DataError if there is no such file, or it is no text.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        problem = "expected a file, not a folder, device or pipe"
        raise DataError(f"cannot be read: {problem}", source=path)
    try:
        if path.stat().st_size > _MAX_TEXT_BYTES:
            raise DataError(f"is too large for a text of settings ({_MAX_TEXT_BYTES} bytes)",
                            source=path)  # fmt: skip
        return path.read_text(encoding="utf-8-sig")  # with the mark that editors on Windows write
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror or error}", source=path) from error
    except UnicodeDecodeError as error:
        raise DataError("expected a text file in UTF-8", source=path) from error


def parse_toml(text: str, source: str | Path = "") -> dict[str, Any]:
    """Return the tables of a TOML text; what is wrong with it names line and column."""
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"is not TOML: {error}", source=source) from error
    except (ValueError, RecursionError) as error:  # integers and nesting beyond all bounds
        raise DataError(f"is not TOML: {error!s:.100}", source=source) from error
    for where, number in _integers(tables):
        if not -(1 << 63) <= number < 1 << 63:  # as TOML demands
            problem = f"expected an integer within 64 bits, got {number!r:.60}"
            raise DataError(problem, field=where, source=source)
    return tables


def _integers(value: Any, where: str = "") -> Iterator[tuple[str, int]]:
    """Yield each integer of nested tables with its name."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _integers(entry, _joined(where, key))
    elif isinstance(value, list):
        for number, entry in enumerate(value):
            yield from _integers(entry, f"{where}[{number}]")
    elif type(value) is int:
        yield where, value


def parse_json(text: str | bytes, source: str | Path = "", field: str = "") -> dict[str, Any]:
    """Return the object of a JSON text; what is wrong with it names file, field and line."""
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        problem = f"not JSON: {error.msg} (line {error.lineno}, column {error.colno})"
        raise DataError(problem, field=field, source=source) from error
    except (ValueError, RecursionError) as error:  # text, integers and nesting beyond all bounds
        raise DataError(f"not JSON: {error!s:.100}", field=field, source=source) from error
    if not isinstance(content, dict):
        raise DataError("expected {...}, a JSON object", field=field, source=source)
    return content


def to_json(value: Any, *, indent: int | None = 2) -> str:
    """Return JSON; numbers that JSON does not know (NaN, infinity) become null."""
    return json.dumps(_plain(value), indent=indent)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy scalars and arrays, without importing NumPy
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


@contextmanager
def settings_of(source: str | Path) -> Iterator[None]:
    """Name the file in every error that does not name one, and make them all a `DataError`."""
    with naming(source), about(""):
        yield


def table_of(table: Mapping[str, Any], key: str, within: str = "") -> Mapping[str, Any]:
    """Return a table within a table, or an empty one."""
    found = table.get(key, {})
    if not isinstance(found, Mapping):
        raise DataError(f"expected a table, got {found!r:.60}", field=_joined(within, key))
    return found


def only(table: Mapping[str, Any], known: Iterable[str], where: str = "") -> None:
    """Raise a `DataError` for the first key that is not known."""
    for key in table:
        if key not in known:
            problem = f"is not known, expected {', '.join(known)}"
            raise DataError(problem, field=_joined(where, key))


def check_keys(table: Any, needed: Mapping[str, bool], where: str) -> None:
    """Raise a `DataError` unless this is a table of these keys, with those that are needed."""
    if not isinstance(table, dict):
        raise DataError(f"expected a table, got {table!r}", field=where)
    for key in table:
        if key not in needed:
            raise DataError(f"expected {', '.join(needed)}, got {key!r}", field=where)
    for key, must in needed.items():
        if must and key not in table:
            raise DataError(f"expected {key!r}, which is missing", field=where)


def built(
    make: Callable[..., T],
    table: Mapping[str, Any],
    where: str,  # name of the table in messages
    beside: Mapping[str, Any] | None = None,  # arguments that do not come from a file
) -> T:
    """Call with the entries of a table, each of the type that is annotated.

    DataError if an entry is unknown, missing, of another type, or refused.
    """
    entries = fitted(make, table, where) | dict(beside or {})
    for name, parameter in parameters(make).items():
        if name not in entries and parameter.default is parameter.empty:
            raise DataError("expected this entry, which is missing", field=_joined(where, name))
    with about(where):
        return make(**entries)


def fitted(make: Callable[..., Any], table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the entries of a table as arguments for `make`, whose annotations they fit.

    What is annotated `Any`, or begins with an underscore, is not for files; what is not annotated,
    as in somebody else's code, is taken as it is.
    """
    plain = inspect.isclass(make) and not is_dataclass(make)
    try:
        hints = get_type_hints(make.__init__ if plain else make)
    except NameError as error:  # a name that only a type checker imports
        raise DataError(f"its annotations cannot be read: {error}", field=where) from error
    names = [one for one in parameters(make) if one[0] != "_" and hints.get(one) is not Any]
    only(table, names, where)
    return {
        key: fit(value, hints[key], _joined(where, key)) if key in hints else value
        for key, value in table.items()
    }


def parameters(make: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return what can be given by name."""
    try:
        found = inspect.signature(make).parameters
    except ValueError as error:  # some compiled code does not tell
        raise DataError("it does not tell its arguments; wrap it in a function") from error
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {name: one for name, one in found.items() if one.kind in named}


def fit(value: Any, kind: Any, where: str) -> Any:
    """Return a value as TOML or JSON has it as the type that an annotation asks for.

    Integers become floats and lists become tuples; nothing else is converted. DataError if it is of
    another type.

    Parameters
    ----------
    kind : bool, int, float, str, Path, a literal, a tuple of any of them, or a union
    where : name of the value in messages
    """
    kinds = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        for one in kinds:
            try:
                return fit(value, one, where)
            except DataError:
                continue
    elif get_origin(kind) is tuple:
        ends = kinds[-1] is not Ellipsis
        if isinstance(value, list | tuple) and (not ends or len(value) == len(kinds)):
            each = kinds if ends else repeat(kinds[0])
            pairs = enumerate(zip(value, each, strict=False))
            return tuple(fit(one, part, f"{where}[{number}]") for number, (one, part) in pairs)
    elif get_origin(kind) is Literal:
        if isinstance(value, str) and value in kinds:
            return value
    elif kind is float:
        if type(value) is float or (type(value) is int and abs(value) <= sys.float_info.max):
            return float(value)
    elif kind is Path:
        if isinstance(value, str | Path):
            return Path(value)
    elif type(value) is kind:
        return value
    raise DataError(f"expected {_words(kind)}, got {value!r:.60}", field=where)


def _words(kind: Any) -> str:
    """Name an annotation for somebody who writes a file."""
    kinds = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(dict.fromkeys(_words(one) for one in kinds if one is not NoneType))
    if get_origin(kind) is tuple:
        return f"[{', '.join('...' if one is Ellipsis else _words(one) for one in kinds)}]"
    if get_origin(kind) is Literal:
        return ", ".join(kinds)
    return "str" if kind is Path else kind.__name__


def _joined(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key
