"""What the options of the methods may be: the one place that says and checks it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Rule:
    """What a value may be.

    Parameters
    ----------
    expected : in words
    holds : whether a value is that
    """

    expected: str
    holds: Callable[[Any], bool]

    def check(self, name: str, value: Any) -> None:
        """Raise a `ValueError` that names the option if the value is not allowed."""
        if not self.holds(value):
            raise ValueError(f"{name}: expected {self.expected}, got {value!r}")


def option(default: Any, rule: Rule) -> Any:
    """Return a field of settings that `check_settings` checks; None may stand for a choice."""
    return field(default=default, metadata={"rule": rule})


def check_settings(settings: Any) -> None:
    """Check the fields that have a rule; None is allowed where it is the default.

    Raises
    ------
    ValueError
        That names the field.
    """
    for one in fields(settings):
        value = getattr(settings, one.name)
        if "rule" in one.metadata and not (value is None and one.default is None):
            one.metadata["rule"].check(one.name, value)


def whole(least: int) -> Rule:
    """Allow whole numbers of at least `least`; a truth value is none."""
    return Rule(
        f"a whole number of at least {least}",
        lambda value: (
            isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
        ),
    )


def positive(most: float = np.inf) -> Rule:
    """Allow finite numbers above 0, up to `most`."""
    return Rule(
        "a positive number" if np.isinf(most) else f"a number above 0 and up to {most:g}",
        lambda value: _is_number(value) and 0.0 < value <= most,
    )


def weight() -> Rule:
    """Allow finite numbers from 0 on, and the name of the way to find one."""
    return Rule(
        'a number of at least 0 or "cross-validation"',
        lambda value: (
            value == "cross-validation"
            if isinstance(value, str)
            else _is_number(value) and value >= 0.0
        ),
    )


def one_of(*names: str) -> Rule:
    """Allow some names."""
    return Rule(
        f"one of {', '.join(names)}", lambda value: isinstance(value, str) and value in names
    )


def truth() -> Rule:
    """Allow true and false."""
    return Rule("True or False", lambda value: isinstance(value, bool | np.bool_))


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, Real) and not isinstance(value, bool) and bool(np.isfinite(float(value)))
    )
