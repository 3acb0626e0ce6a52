"""How many small faults the tests notice: one change at a time in core, forward and reconstruction.

python benchmarks/mutants.py --count 100 --seed 1

Each mutant swaps an operator or a comparison, moves a number by one, or drops a `not`, in a copy of
the source; the tests of that folder (and of those that build on it) run until the first failure.
Docstrings, messages, types and the limits of loops that only cost time are not told apart from the
rest: a mutant that no test can notice counts as one that lives. Prints each survivor and the share
that was killed.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
    """Yield all changes of one file, each within a line."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare):
            parts = (
                (node.left, node.op, node.right) if isinstance(node, ast.BinOp)
                else (node.values[0], node.op, node.values[1]) if isinstance(node, ast.BoolOp)
                else (node.left, node.ops[0], node.comparators[0])
            )  # fmt: skip
            before, operator, after = parts
            if type(operator) in SWAPS and before.end_lineno == after.lineno:
                start, end = before.end_col_offset or 0, after.col_offset
                row = path.read_text().splitlines()[after.lineno - 1].encode()[start:end].decode()
                if not set(row) & set("()"):
                    yield Mutant(path, after.lineno, start, end, f" {SWAPS[type(operator)]} ")
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            place = (node.lineno, node.col_offset, node.end_col_offset or 0)
            yield Mutant(path, *place, repr(node.value + 1))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield Mutant(path, node.lineno, node.col_offset, node.operand.col_offset, "")


def is_python(mutant: Mutant) -> bool:
    """Return whether there is anything to test: a sign before a comma is none."""
    try:
        ast.parse(mutant.of(mutant.path.read_text()))
    except SyntaxError:
        return False
    return True


def killed(mutant: Mutant, copy: Path) -> bool:
    """Return whether a test fails on the mutant, or does not end."""
    inside = mutant.path.relative_to(ROOT / "src" / "lensshift")
    target, source = copy / "lensshift" / inside, mutant.path.read_text()
    target.write_text(mutant.of(source))
    folders = [str(ROOT / "tests" / name) for name in TESTS[inside.parts[0]]]
    own = ROOT / "tests" / inside.parts[0] / f"test_{inside.stem}.py"
    folders = [*([str(own)] if own.exists() else []), *folders]  # what kills most comes first
    options = ["-x", "-q", "-m", "not slow and not hardware", "-p", "no:cacheprovider"]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *folders],
            cwd=ROOT, env={**os.environ, "PYTHONPATH": str(copy)},
            capture_output=True, check=False, timeout=LONGEST_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return True
    finally:
        target.write_text(source)
    return done.returncode != 0


def main() -> None:
    """Print the share of a random sample of mutants that the tests kill."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--count", type=int, default=100)
    ask.add_argument("--seed", type=int, default=1)
    given = ask.parse_args()
    files = [path for name in TESTS for path in (ROOT / "src/lensshift" / name).rglob("*.py")]
    everything = [one for path in sorted(files) for one in mutants_of(path) if is_python(one)]
    sample = random.Random(given.seed).sample(everything, given.count)
    dead = 0
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "src" / "lensshift", Path(folder) / "lensshift")
        for number, mutant in enumerate(sample, 1):
            gone = killed(mutant, Path(folder))
            dead += gone
            line = mutant.path.read_text().splitlines()[mutant.line - 1].strip()
            name = mutant.path.relative_to(ROOT / "src")
            state = "killed" if gone else f"LIVES  {name}:{mutant.line}: {line} -> {mutant.text}"
            sys.stdout.write(f"{number:4d} {dead / number:6.1%} {state}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
