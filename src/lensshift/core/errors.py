"""What can go wrong, in words for somebody who stands at the bench."""

from __future__ import annotations

from pathlib import Path


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
        super().__init__(": ".join(part for part in (self.source, field, self.problem) if part))

    def in_file(self, source: str | Path) -> DataError:
        """Return the same error with the name of the file in front."""
        return DataError(self.problem, field=self.field, source=source)


class QualityWarning(UserWarning):
    """The data are poor but usable; the message says by how much."""
