"""What a stream keeps of one step for the next."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any


@dataclass(slots=True)
class Memory:
    """Laws of noise and half-done pictures of a step, in the order in which the next one asks.

    Parameters
    ----------
    quick : whether the step that runs takes what is remembered and does the last stage only; else
        it computes all anew
    """

    quick: bool = False
    _before: deque[Any] = field(default_factory=deque)
    _now: list[Any] = field(default_factory=list)

    def begin(self, *, quick: bool) -> None:
        """Begin a step; what the last one kept is remembered."""
        self.quick = quick
        self._before, self._now = deque(self._now), []

    def recalled(self) -> Any:
        """Return what was kept at this point of the step before, None if it is to be made anew."""
        found = self._before.popleft() if self._before else None
        return found if self.quick else None

    def keep(self, thing: Any) -> None:
        """Keep something for this point of the next step."""
        self._now.append(thing)
