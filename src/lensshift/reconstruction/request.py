"""What the caller asks of a method beyond the burst."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal


@dataclass(frozen=True, slots=True)
class Request:
    """Settings that every method is handed; each takes what it knows.

    Parameters
    ----------
    prior_weight : a number, None for the automatic choice, or "cross-validation"
    seed : of everything random
    non_negative : whether negative values are forbidden
    std : whether the propagated noise is wanted
    on_iteration : called with the number of the iteration and the objective
    options : keyword arguments that only this method knows
    frames : numbers of the frames in the burst
    blur_told : whether the user or the burst told the pixel response
    shifts_doubted : whether the shifts were found to be wrong as a whole, and the user was told
    """

    prior_weight: float | Literal["cross-validation"] | None = None
    seed: int = 0
    non_negative: bool = False
    std: bool = True
    on_iteration: Callable[[int, float], None] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    frames: Sequence[int] = ()
    blur_told: bool = False
    shifts_doubted: bool = False
