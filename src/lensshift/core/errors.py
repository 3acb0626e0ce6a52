"""What can go wrong, in words for somebody who stands at the bench."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any


def printable(text: str) -> str:
    r"""Return a text in which what a terminal would obey is written out, as in \x1b.

    Names, notes and messages come from files and devices of anybody.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in "\n\t" else repr(one)[1:-1] for one in text)


class DataError(ValueError):
    """A file or a burst is unreadable or contradicts itself.

    Parameters
    ----------
    problem : what is wrong, what was expected and what to do, in one line
    field : name of the field of the burst or file
    source : the file
    """

    def __init__(self, problem: str, *, field: str = "", source: str | Path = "") -> None:
        self.problem = " ".join(problem.split())
        self.field = field
        self.source = str(source)
        parts = (self.source, field, self.problem)
        super().__init__(printable(": ".join(part for part in parts if part)))

    def in_file(self, source: str | Path) -> DataError:
        """Return the same error with the name of the file in front, unless it names one."""
        return DataError(self.problem, field=self.field, source=self.source or source)


def of_extra(module: str, needed: str) -> Any:
    """Return a module of an extra; where it is missing, an ImportError that says what is needed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(needed) from error


@contextmanager
def naming(source: str | Path) -> Iterator[None]:
    """Give each `DataError` of the block the name of the file, unless it names one."""
    try:
        yield
    except DataError as error:
        raise error.in_file(source) from error


@contextmanager
def about(field: str) -> Iterator[None]:
    """Make what a block refuses a `DataError` about a field, unless it names one."""
    try:
        yield
    except DataError:
        raise
    except (TypeError, ValueError) as error:
        raise DataError(str(error), field=field) from error


class QualityWarning(UserWarning):
    """The data are poor but usable; the message says by how much."""


class WorstWarning(QualityWarning):
    """One of several that say the same of different things: the worst of them is enough.

    Parameters
    ----------
    problem : what is wrong
    worse : the larger, the worse
    """

    def __init__(self, problem: str, worse: float) -> None:
        super().__init__(problem)
        self.worse = worse


def warn_quality(problem: str | QualityWarning, stacklevel: int = 2) -> None:
    """Give a `QualityWarning`, about the line that `warnings.warn` would name from here."""
    warnings.warn(problem, QualityWarning, stacklevel=stacklevel + 1)  # a warning keeps its class


class DeviceError(RuntimeError):
    """A device of the rig refuses, fails, or has gone.

    Parameters
    ----------
    problem : what happened and what to do, in one line
    device : its name, as the user knows it
    command : what it was asked to do
    position_mm : where the stage was last known to be
    """

    def __init__(
        self,
        problem: str,
        *,
        device: str = "",
        command: str = "",
        position_mm: tuple[float, ...] | None = None,
    ) -> None:
        self.problem = " ".join(problem.split())
        self.device = device
        self.command = command
        self.position_mm = position_mm
        parts = [part for part in (device, command, self.problem) if part]
        if position_mm is not None:
            parts[-1] += f" (last position {', '.join(f'{x:.4f}' for x in position_mm)} mm)"
        super().__init__(printable(": ".join(parts)))


class DeviceTimeout(DeviceError):  # noqa: N818 - as TimeoutError's relatives are named
    """A device did not answer, move or send in time."""
