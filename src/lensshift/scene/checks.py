"""What shapes and textures demand of their numbers, as messages that name the field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

import numpy as np

from lensshift.core.arrays import Floats


def number(name: str, value: object) -> float:
    """Return a finite number; raise TypeError or ValueError unless it is one."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"expected a number for {name}, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"expected a finite {name}, got {value}")
    return float(value)


def positive(name: str, value: object) -> float:
    """Return a finite number above 0."""
    if not number(name, value) > 0:
        raise ValueError(f"expected a positive {name}, got {value}")
    return number(name, value)


def share(name: str, value: object) -> float:
    """Return a number from 0 to 1."""
    if not 0 <= number(name, value) <= 1:
        raise ValueError(f"expected {name} from 0 to 1, got {value}")
    return number(name, value)


def numbers(name: str, value: object, count: int | None = None) -> tuple[float, ...]:
    """Return finite numbers, as many as `count` unless that is None."""
    words = "finite numbers" if count is None else f"{count} finite numbers"
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str):
        raise TypeError(f"expected {words} for {name}, got {value!r}")
    if count is not None and len(value) != count:
        raise ValueError(f"expected {words} for {name}, got {value!r}")
    return tuple(number(f"each of {name}", one) for one in value)


def positives(name: str, value: object, count: int | None = None) -> tuple[float, ...]:
    """Return finite numbers above 0, as many as `count` unless that is None."""
    return tuple(positive(f"each of {name}", one) for one in numbers(name, value, count))


def table(name: str, value: object) -> Floats:
    """Return [row col] of finite numbers, read-only; at least one."""
    try:
        rows = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected a table of numbers for {name}: {error}") from error
    if rows.ndim != 2 or not rows.size or not np.all(np.isfinite(rows)):
        raise ValueError(f"expected finite numbers [row col] for {name}, got shape {rows.shape}")
    rows.flags.writeable = False
    return rows
