"""Pages that are written by the program itself: every public name, every verb, every method."""

import inspect
import pkgutil
import re
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, get_origin

from sphinx.application import Sphinx

# Packages whose names people import, with what they are for.
PACKAGES = {
    "lensshift": "What most people need: everything here is `lensshift.NAME`.",
    "lensshift.reconstruction.methods": "The methods as values, and their registry.",
    "lensshift.registration": "Shifts from frames, calibration of a rig.",
    "lensshift.evaluation": "Numbers that say how good an image is.",
    "lensshift.evaluation.slanted_edge": "The MTF from slanted edges.",
    "lensshift.evaluation.gain": "How much finer one image is than another.",
    "lensshift.evaluation.limits": "Closed forms of what pixels and lenses can do.",
    "lensshift.io": "Files.",
    "lensshift.core.types": "The nouns that travel along the chain.",
    "lensshift.core.intrinsics": "Where pixels look.",
    "lensshift.core.pattern": "Patterns of shifts.",
    "lensshift.camera": "Simulated cameras.",
    "lensshift.scene": "Simulated worlds.",
    "lensshift.optics": "Lenses: one module each.",
    "lensshift.capture": "The rig: one module each.",
    "lensshift.pipeline": "The whole chain.",
    "lensshift.report": "Figures: one module each.",
}
_GENERATED = Path(__file__).resolve().parents[1] / "generated"
_WRITTEN: set[Path] = set()
# Members that every class has from Python.
_NOT_SHOWN = ("object", "int", "str", "float", "tuple", "list", "dict", "Enum", "BaseException")
_SECTION = re.compile(r"^-{3,}$")


def public_names(name: str) -> dict[str, list[str]]:
    """Return module -> public names of a module, or of the modules of a package without a list."""
    module = import_module(name)
    listed = getattr(module, "__all__", None)
    if listed is not None:
        kept = [one for one in listed if not one.startswith("_")]
        return {name: [one for one in kept if get_origin(getattr(module, one)) is None]}
    found = {name: _own(module)}
    if hasattr(module, "__path__"):
        for part in pkgutil.iter_modules(module.__path__):
            if not part.ispkg and not part.name.startswith("_"):
                inner = f"{name}.{part.name}"
                try:
                    found[inner] = _own(import_module(inner))
                except ImportError:  # of an extra that is not installed
                    continue
    return {place: names for place, names in found.items() if names}


def documented() -> dict[str, str]:
    """Return every public name with the name that its page has: the first it is met by."""
    first: dict[int, str] = {}
    found: dict[str, str] = {}
    for package in PACKAGES:
        for module, names in public_names(package).items():
            for name in names:
                value = getattr(import_module(module), name)
                known = inspect.isclass(value) or inspect.isroutine(value)
                whole = f"{module}.{name}"
                found[whole] = first.setdefault(id(value), whole) if known else whole
    return found


def _own(module: ModuleType) -> list[str]:
    names = []
    for name, value in vars(module).items():
        reexported = f"import {name} as {name}" in inspect.getsource(module)
        ours = getattr(value, "__module__", None) == module.__name__ or reexported
        if not name.startswith("_") and ours and (inspect.isclass(value) or callable(value)):
            names.append(name)
    return sorted(names)


def _write(path: Path, text: str) -> None:
    """Write a page, unless it is that already: an old one is not built again."""
    _WRITTEN.add(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _name_page(whole: str) -> None:
    """Write the page of one name. It is in no list of contents: hundreds would slow every page."""
    module, name = whole.rsplit(".", 1)
    value = getattr(import_module(module), name)
    members = ""
    if inspect.isclass(value):
        kind = "exception" if issubclass(value, BaseException) else "class"
        members = "   :members:\n   :inherited-members: " + ", ".join(_NOT_SHOWN) + "\n"
    else:
        kind = "function" if inspect.isroutine(value) else "data"
    text = (
        f":orphan:\n\n{name}\n{'=' * len(name)}\n\nIn :doc:`{module} <../{_package_of(module)}>`."
        f"\n\n.. currentmodule:: {module}\n\n.. auto{kind}:: {name}\n{members}"
    )
    _write(_GENERATED / "api" / "names" / f"{whole}.rst", text)


def _package_of(module: str) -> str:
    """Return the package on whose page a module is listed."""
    return max((one for one in PACKAGES if f"{module}.".startswith(f"{one}.")), key=len)


def _api() -> None:
    pages, place = [], documented()
    for whole in sorted(set(place.values())):
        _name_page(whole)
    for package, purpose in PACKAGES.items():
        parts = [f"{package}\n{'=' * len(package)}\n\n{purpose}\n"]
        for module, names in public_names(package).items():
            if module != package:
                parts.append(f"{module}\n{'-' * len(module)}\n")
            parts.append(".. autosummary::\n")
            parts.append("\n".join(f"   ~{place[f'{module}.{name}']}" for name in names) + "\n")
        _write(_GENERATED / "api" / f"{package}.rst", "\n".join(parts))
        pages.append(f"   {package}")
    text = (
        "Python\n======\n\nEvery public name, with what it takes, returns and raises.\n\n"
        ".. toctree::\n   :maxdepth: 1\n\n" + "\n".join(pages) + "\n"
    )
    _write(_GENERATED / "api" / "index.rst", text)


def _verbs(command: Any, words: list[str]) -> list[tuple[str, str]]:
    """Return the words of each verb with its help."""
    from typer.testing import CliRunner

    from lensshift.cli.app import app

    told = CliRunner().invoke(app, [*words, "--help"], terminal_width=90, env={"COLUMNS": "90"})
    found = [(" ".join(["lensshift", *words]), told.stdout.replace("Usage: root", "Usage:"))]
    for name, verb in sorted(getattr(command, "commands", {}).items()):
        found += _verbs(verb, [*words, name])
    return found


def _command_line() -> None:
    from typer.main import get_command

    from lensshift.cli.app import app

    parts = ["Command line\n============\n\nWhat ``--help`` says, verb by verb.\n"]
    for words, text in _verbs(get_command(app), []):
        body = "\n".join(f"   {line}".rstrip() for line in text.strip().splitlines())
        parts.append(f"{words}\n{'-' * len(words)}\n\n.. code-block:: none\n\n{body}\n")
    _write(_GENERATED / "command-line.rst", "\n".join(parts))


def _methods() -> None:
    from lensshift.reconstruction.methods import METHODS

    pages = []
    for name, method in METHODS.items():
        place = f"{method.__module__}.{method.__name__}"
        rows = [
            f"   * - ``{one.name}``\n     - ``{one.default!r}``\n"
            f"     - {one.metadata['rule'].expected if 'rule' in one.metadata else ''}"
            for one in fields(method)
        ]
        table = (
            ".. list-table::\n   :header-rows: 1\n\n   * - option\n     - default\n"
            "     - allowed\n" + "\n".join(rows)
            if rows
            else "It has no options."
        )
        first = f" --option {fields(method)[-1].name}=..." if rows else ""
        text = (
            f"{name}\n{'=' * len(name)}\n\n{method.summary[0].upper()}{method.summary[1:]}.\n\n"
            f".. code-block:: none\n\n   lensshift reconstruct burst.nc --method {name}{first}\n\n"
            f'.. code-block:: python\n\n   lensshift.reconstruct(burst, method="{name}", ...)\n\n'
            f"{table}\n\n.. autoclass:: {place}\n   :no-index:\n"
        )
        _write(_GENERATED / "methods" / f"{name}.rst", text)
        pages.append(f"   {name}")
    text = (
        "Methods\n=======\n\nAll of them by ``lensshift.reconstruct(burst, method=...)``, a name "
        "or a value such as ``Tv(iterations=30)``.\nWhat holds for all of them: "
        ":func:`lensshift.reconstruct`.\n\n.. toctree::\n   :maxdepth: 1\n\n"
        + "\n".join(pages) + "\n"
    )  # fmt: skip
    _write(_GENERATED / "methods" / "index.rst", text)


def _written(app: Sphinx) -> None:
    _api()
    _command_line()
    _methods()
    for path in _GENERATED.rglob("*.rst"):
        if path not in _WRITTEN:  # of a name that is no more
            path.unlink()


def _plain_text(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Make reStructuredText of docstrings: equations stay as they are, nothing is markup."""
    out: list[str] = []
    literal = False
    for number, line in enumerate(lines):
        indented = line.startswith("    ") and bool(line.strip())
        if not line.strip():
            out.append(line)
            continue
        if literal and indented:
            out.append(line)
            continue
        literal = False
        after_blank = number > 0 and not lines[number - 1].strip()
        if indented and after_blank and not _in_section(lines, number):
            out += ["::", ""]
            literal = True
            out.append(line)
        elif _SECTION.match(line) or ">>>" in line:
            out.append(line)
        else:
            out.append(_escaped(line))
    lines[:] = out


def _in_section(lines: list[str], number: int) -> bool:
    return any(_SECTION.match(line) for line in lines[:number])


def _escaped(line: str) -> str:
    """Return a line whose stars, bars and underscores mean themselves; `name` becomes code."""
    parts = re.split(r"(``[^`]*``|`[^`]*`)", line)
    for place, part in enumerate(parts):
        if place % 2:
            parts[place] = part if part.startswith("``") else f"`{part}`"
        else:
            parts[place] = re.sub(r"([*|]|_(?=\W|$))", r"\\\1", part)
    return "".join(parts)


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before anything is read, and docstrings before numpydoc reads them."""
    app.connect("builder-inited", _written, priority=100)
    app.connect("autodoc-process-docstring", _plain_text, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
