"""What the options of the methods may be: the one place that says and checks it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
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


# Arguments that mean the same wherever they occur, also as settings of a solver.
RULES: Mapping[str, Rule] = {
    "iterations": whole(1),
    "inner_iterations": whole(1),
    "window": whole(1),
    "alpha": positive(1.0),
    "sparsity": positive(1.0),
    "threshold": positive(),
    "bias_threshold": positive(),
    "smoothing": positive(),
    "prior_weight": weight(),
    "data_term": one_of("l2", "l1", "huber"),
    "seed": whole(0),
    "noise_sigma": positive(),
    "photometric": truth(),
    "non_negative": truth(),
    "std": truth(),
    "frame": whole(0),
    "pixfrac": positive(1.0),
    "kernel": one_of("square", "point"),
    "algorithm": one_of("wiener", "unsupervised", "richardson-lucy"),
}


def options(*names: str, **rules: Rule) -> Mapping[str, Rule]:
    """Return the rules of the options of a method: known ones by name, others with their rule."""
    return {name: RULES[name] for name in names} | rules


def check_options(method: str, given: Mapping[str, Any], known: Mapping[str, Rule]) -> None:
    """Refuse options that a method does not know, or values that they cannot have.

    Raises
    ------
    ValueError
        That names the method or the option.
    """
    unknown = sorted(set(given) - set(known))
    if unknown:
        names = ", ".join(known) or "none"
        raise ValueError(f"{method} does not know {', '.join(unknown)}; its options: {names}")
    for name, value in given.items():
        known[name].check(name, value)


def check_settings(settings: Any) -> None:
    """Check the fields of a solver's settings that have a rule; None stands for a choice.

    Raises
    ------
    ValueError
        That names the field.
    """
    for field in fields(settings):
        value = getattr(settings, field.name)
        if field.name in RULES and not (value is None and field.default is None):
            RULES[field.name].check(field.name, value)


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, Real) and not isinstance(value, bool) and bool(np.isfinite(float(value)))
    )
