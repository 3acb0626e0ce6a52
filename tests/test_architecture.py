"""The house keeps its own rules: who may import whom, names, sizes, and what code never does."""

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import lensshift

PACKAGE = Path(lensshift.__file__).parent
ROOT = PACKAGE.parents[1]
MODULES = sorted(PACKAGE.rglob("*.py"))
MAX_MODULE_LINES = 400
MAX_FUNCTION_LINES = 60  # without the docstring
EMPTY_NAMES = {"utils", "util", "helpers", "common", "misc", "base", "manager"}

FORBIDDEN_CALLS = {"print", "breakpoint", "eval", "exec"}

# Endings that tell the unit of a float.
UNITS = {
    "mm", "m", "nm", "px", "lpmm", "rad", "deg", "hz", "s", "db", "mps", "electrons", "seconds",
}  # fmt: skip
# Words that speak of a length, a time, an angle, a frequency or a level.
DIMENSIONED = {
    "offset", "shift", "pitch", "distance", "position", "place", "width", "height", "length",
    "radius", "size", "border", "time", "duration", "angle", "slant", "turn", "phase", "tilt",
    "wavelength", "frequency", "modulation", "psnr", "decenter", "stage", "period", "row", "col",
}  # fmt: skip
# Plain numbers with such a word in their name: a step of a solver, counts, shares.
DIMENSIONLESS = {
    "modulation",  # contrast of an MTF
    "step_size", "row_weight", "col_weight", "row_share", "col_share", "photometric_offset",
}  # fmt: skip


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def named(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def code_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    assert function.end_lineno is not None
    lines = function.end_lineno - function.lineno + 1
    docstring = ast.get_docstring(function, clean=False)
    return lines - (docstring.count("\n") + 1 if docstring else 0)


def test_imports_go_one_way(monkeypatch: pytest.MonkeyPatch) -> None:
    api = pytest.importorskip("importlinter.cli", reason="import-linter is not installed")
    monkeypatch.chdir(ROOT)
    assert api.lint_imports(config_filename="pyproject.toml", cache_dir=None) == 0


def test_modules_are_short() -> None:
    lines = {named(path): path.read_text(encoding="utf-8").count("\n") for path in MODULES}
    assert {name: n for name, n in lines.items() if n > MAX_MODULE_LINES} == {}


def test_functions_are_short() -> None:
    lines = {
        f"{named(path)}: {f.name}": code_lines(f)
        for path in MODULES
        for f in functions(parsed(path))
    }
    assert {name: n for name, n in lines.items() if n > MAX_FUNCTION_LINES} == {}


def test_names_of_modules_say_something() -> None:
    assert [named(one) for one in MODULES if EMPTY_NAMES & {one.stem, one.parent.name}] == []


def forbidden(tree: ast.Module) -> list[str]:
    """Return what library code must not do, with line numbers."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            found.append(f"{node.lineno}: assert")
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in FORBIDDEN_CALLS:
            found.append(f"{node.lineno}: {ast.unparse(node.func)}")
        if isinstance(node, ast.ExceptHandler):
            kinds = [node.type, *(node.type.elts if isinstance(node.type, ast.Tuple) else ())]
            names = {getattr(kind, "id", "" if kind else "everything") for kind in kinds}
            if names & {"everything", "Exception", "BaseException"}:
                found.append(f"{node.lineno}: broad except")
    return found


def test_library_code_neither_prints_nor_asserts_nor_swallows() -> None:
    found = {named(path): forbidden(parsed(path)) for path in MODULES}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_the_search_finds_what_it_looks_for() -> None:
    bad = """
def f(shift: float, offset_px: float, gain: float) -> None:
    print(shift)
    assert shift
    try:
        f(1, 2, 3)
    except (ValueError, Exception):
        pass
    try:
        f(1, 2, 3)
    except:
        pass
"""
    kinds = [line.split(": ")[1] for line in forbidden(ast.parse(bad))]
    assert sorted(kinds) == ["assert", "broad except", "broad except", "print"]
    assert list(without_unit(ast.parse(bad))) == ["2: f(shift)"]
    fine = "class Grid:\n    pitch_mm: float\n    height: NDArray[np.float64] | None\n"
    assert list(without_unit(ast.parse(fine))) == ["3: Grid.height"]


FLOAT = re.compile(r"\bfloat(32|64)?\b|\bArrayLike\b")


def lacks_unit(name: str, annotation: ast.expr | None) -> bool:
    """Tell whether a float speaks of a dimension and does not say its unit."""
    if annotation is None or not FLOAT.search(ast.unparse(annotation)):
        return False
    if "Callable" in ast.unparse(annotation) or name.lstrip("_") in DIMENSIONLESS:
        return False
    words = name.lower().strip("_").split("_")
    return bool(DIMENSIONED & set(words)) and words[-1] not in UNITS


def without_unit(tree: ast.Module) -> Iterator[str]:
    """Yield public float parameters and fields whose dimension has no unit."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.ClassDef | ast.FunctionDef) or node.name.startswith("_"):
            continue
        floats: list[tuple[int, str, ast.expr | None]] = []
        if isinstance(node, ast.ClassDef):
            fields = [item for item in node.body if isinstance(item, ast.AnnAssign)]
            floats = [(f.lineno, ast.unparse(f.target), f.annotation) for f in fields]
            label = f"{node.name}.{{}}"
        else:
            takes = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            floats = [(node.lineno, one.arg, one.annotation) for one in takes]
            label = f"{node.name}({{}})"
        for line, name, annotation in floats:
            if lacks_unit(name, annotation):
                yield f"{line}: {label.format(name)}"


def test_floats_with_a_dimension_say_their_unit() -> None:
    found = {named(path): list(without_unit(parsed(path))) for path in MODULES}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_every_extra_that_is_named_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    texts = [path.read_text(encoding="utf-8") for path in (*MODULES, ROOT / "CHANGELOG.md")]
    named = set(re.findall(r"lensshift\[(\w+)\]|extra `(\w+)`", "\n".join(texts)))
    extras = {first or second for first, second in named}
    assert extras
    assert extras <= set(project["optional-dependencies"])
