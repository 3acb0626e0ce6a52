"""How many small faults the tests notice: one change at a time in core, forward and reconstruction.

python benchmarks/mutants.py --count 100 --seed 1

Each mutant swaps an operator or a comparison, moves a number by one, or drops a `not`, in a copy of
the source; the tests of that folder (and of those that build on it) run until the first failure,
first the files that name the module. With --near only those: what lives may die of the others, so
the share is a lower bound, at seconds a mutant instead of minutes.
Docstrings, messages, types and the limits of loops that only cost time are not told apart from the
rest: a mutant that no test can notice counts as one that lives. Prints each survivor and the share
that was killed.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numba
import pytest
import scipy.ndimage  # noqa: F401 forked with the rest

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "core": ("core", "forward", "io", "reconstruction"),
    "forward": ("forward", "reconstruction"),
    "reconstruction": ("reconstruction", "pipeline"),
}
SWAPS: dict[type, str] = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Lt: ">=", ast.GtE: "<",
    ast.Gt: "<=", ast.LtE: ">", ast.Eq: "!=", ast.NotEq: "==", ast.And: "or", ast.Or: "and",
}  # fmt: skip
LONGEST_S = 600


@dataclass(frozen=True)
class Mutant:
    """A place of a file, and what stands there instead."""

    path: Path
    line: int
    start: int
    end: int
    text: str

    def of(self, source: str) -> str:
        """Return the source with the change."""
        lines = source.splitlines(keepends=True)
        row = lines[self.line - 1].encode()
        changed = row[: self.start] + self.text.encode() + row[self.end :]
        return "".join([*lines[: self.line - 1], changed.decode(), *lines[self.line :]])


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield all changes of one file, each within a line and with no bracket of a pair."""
    source = path.read_text()
    rows = [row.encode() for row in source.splitlines()]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare):
            parts = (
                (node.left, node.op, node.right) if isinstance(node, ast.BinOp)
                else (node.values[0], node.op, node.values[1]) if isinstance(node, ast.BoolOp)
                else (node.left, node.ops[0], node.comparators[0])
            )  # fmt: skip
            before, operator, after = parts
            if type(operator) in SWAPS and before.end_lineno == after.lineno:
                start, end = before.end_col_offset or 0, after.col_offset
                if not set(rows[after.lineno - 1][start:end]) & set(b"()"):
                    yield Mutant(path, after.lineno, start, end, f" {SWAPS[type(operator)]} ")
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            place = (node.lineno, node.col_offset, node.end_col_offset or 0)
            yield Mutant(path, *place, repr(node.value + 1))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            start, end = node.col_offset, node.operand.col_offset
            if not set(rows[node.lineno - 1][start:end]) & set(b"()"):
                yield Mutant(path, node.lineno, start, end, "")


def tests_of(path: Path, *, near: bool) -> list[str]:
    """Return the test files to run, those first that name the module or else what imports it."""
    inside = path.relative_to(ROOT / "src").with_suffix("")
    files = [
        file
        for name in TESTS[inside.parts[1]]
        for file in (ROOT / "tests" / name).glob("test_*.py")
    ]
    modules = {".".join(inside.parts)}

    def naming(among: Iterable[Path]) -> list[Path]:
        told = re.compile("|".join(rf"\b{re.escape(module)}\b(?!\.)" for module in modules))
        return sorted(file for file in among if told.search(file.read_text()))

    first = naming(files) or naming((ROOT / "tests").rglob("test_*.py"))
    if not first:
        using = naming((ROOT / "src" / "lensshift").rglob("*.py"))
        modules = {".".join(user.relative_to(ROOT / "src").with_suffix("").parts) for user in using}
        first = naming(files) if modules else []
    first.sort(key=lambda file: file.stem != f"test_{path.stem}")
    rest = [] if near and first else [file for file in files if file not in first]
    return [str(file) for file in first + rest]


def killed(mutant: Mutant, copy: Path, *, near: bool) -> bool:
    """Return whether a test fails on the mutant, or does not end."""
    source = mutant.path
    target = copy / source.relative_to(ROOT / "src")
    target.write_text(mutant.of(source.read_text()))
    options = ["-x", "-q", "-n0", "-m", "not slow and not hardware", "-p", "no:cacheprovider"]
    with tempfile.TemporaryDirectory() as kernels:
        child = os.fork()  # with numpy and numba, which take longer to import than most tests
        if child == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(1, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S))
            if "numba" in source.read_text():  # kernels kept of other files hold this one's too
                numba.config.CACHE_DIR = kernels
            sys.dont_write_bytecode = True
            os.chdir(ROOT)
            os._exit(int(pytest.main([*options, *tests_of(source, near=near)])))
        _, state = os.waitpid(child, 0)
    shutil.copy2(source, target)  # with its time: compiled kernels stay good
    return state != 0


def main() -> None:
    """Print the share of a random sample of mutants that the tests kill."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--count", type=int, default=100)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--near", action="store_true", help="only tests that name the module")
    ask.add_argument("--only", default="", help="only files whose path has this in it")
    given = ask.parse_args()
    files = [path for name in TESTS for path in (ROOT / "src/lensshift" / name).rglob("*.py")]
    files = [path for path in files if given.only in str(path.relative_to(ROOT / "src"))]
    everything = [one for path in sorted(files) for one in mutants_of(path)]
    sample = random.Random(given.seed).sample(everything, min(given.count, len(everything)))
    dead = 0
    with tempfile.TemporaryDirectory() as folder:
        sys.path.insert(0, folder)
        os.environ["PYTHONPATH"] = folder  # for processes that tests start
        shutil.copytree(ROOT / "src" / "lensshift", Path(folder) / "lensshift")
        for number, mutant in enumerate(sample, 1):
            gone = killed(mutant, Path(folder), near=given.near)
            dead += gone
            line = mutant.path.read_text().splitlines()[mutant.line - 1].strip()
            name = mutant.path.relative_to(ROOT / "src")
            state = "killed" if gone else f"LIVES  {name}:{mutant.line}: {line} -> {mutant.text}"
            sys.stdout.write(f"{number:4d} {dead / number:6.1%} {state}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
