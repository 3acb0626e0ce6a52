"""Claims of the paper, what was measured for each, and what follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Verdict = Literal["confirmed", "qualified", "refuted"]
Pair = tuple[float, float]

_DRAWS = 4000
_ENOUGH = 5  # values for a bootstrap


@dataclass(frozen=True, slots=True)
class Claim:
    """One statement of the paper, measured.

    Parameters
    ----------
    id : short name
    statement : the paper's, in our words
    paper : its number, or in words what it shows
    ours : our number
    interval : 95 %, over noise, shift errors and edge phases; for numbers without chance the
        range over what was tried
    verdict : "confirmed", "qualified" or "refuted"
    why : one sentence
    """

    id: str
    statement: str
    paper: str
    ours: float
    interval: Pair
    verdict: Verdict
    why: str


def mean_interval(values: Sequence[float], *, seed: int = 0) -> tuple[float, Pair]:
    """Return the mean and 95 % of it, from a bootstrap over independent values.

    For fewer than five values the interval is that of Student's t.
    """
    sample = np.asarray(values, dtype=np.float64)
    mean = float(sample.mean())
    if len(sample) < 2:
        return mean, (float("nan"), float("nan"))
    if len(sample) < _ENOUGH:
        from scipy.stats import t

        half = float(t.ppf(0.975, len(sample) - 1) * sample.std(ddof=1) / np.sqrt(len(sample)))
        return mean, (mean - half, mean + half)
    rng = np.random.default_rng(seed)
    draws = rng.choice(sample, (_DRAWS, len(sample))).mean(axis=1)
    low, high = np.percentile(draws, (2.5, 97.5)).tolist()
    return mean, (low, high)


def pooled_interval(measured: Sequence[tuple[float, float, float]]) -> tuple[float, Pair]:
    """Return the mean of measurements (value, low, high) and 95 % of it.

    From the spread of the values; for fewer than five from the intervals of the single ones, which
    know of noise within an image but not of shift errors.
    """
    values = [value for value, _, _ in measured]
    if len(values) >= _ENOUGH:
        return mean_interval(values)
    low, high = (float(np.mean([one[end] for one in measured])) for end in (1, 2))
    return float(np.mean(values)), (low, high)


def span(values: Sequence[float]) -> Pair:
    """Return the smallest and the largest value."""
    return float(min(values)), float(max(values))
