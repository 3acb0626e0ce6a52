"""The methods that `reconstruct` knows, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from lensshift.core.types import Estimate
from lensshift.reconstruction import bilateral, direct, sparse
from lensshift.reconstruction.learned.method import auto
from lensshift.reconstruction.options import Rule, one_of, options
from lensshift.reconstruction.priors import PRIORS
from lensshift.reconstruction.problem import Problem, brightness_of, peak_of
from lensshift.reconstruction.request import Request

Run = Callable[[Problem, Request], Estimate]


@dataclass(frozen=True, slots=True)
class Method:
    """A registered method.

    Parameters
    ----------
    summary : one line for people who choose
    run : Problem, Request -> Estimate in units of the problem's intensity
    intensity : what the frames are divided by before
    options : keyword arguments of `reconstruct` that only this method knows, and what they may be
    weighs_prior : whether it takes a `prior_weight`
    take_level, keep_outside : as in `make_problem`
    """

    summary: str
    run: Run
    intensity: Callable[..., float] = brightness_of
    options: Mapping[str, Rule] = field(default_factory=dict)
    weighs_prior: bool = True
    take_level: bool = True
    keep_outside: bool = False


METHODS: Mapping[str, Method] = {
    "auto": Method(
        "exact data steps and a learned prior, which needs no weight; the default",
        auto,
        weighs_prior=False,
    ),
    "nearest": Method(
        "one frame, each HR pixel from the nearest LR pixel",
        direct.nearest,
        options=options("frame"),
        weighs_prior=False,
    ),
    "bicubic": Method(
        "Keys' cubic interpolation of one frame, or mean or median of the aligned frames",
        direct.bicubic,
        options=options("frame", combine=one_of("first", "mean", "median")),
        weighs_prior=False,
    ),
    "deconvolution": Method(
        "one frame, interpolated and deconvolved by scikit-image",
        direct.deconvolution,
        options=options("frame", "algorithm"),
        weighs_prior=False,
        take_level=False,  # Richardson and Lucy want no negative values
    ),
    "shift-and-add": Method(
        "every LR sample dropped into the nearest HR pixel, holes filled",
        direct.shift_and_add,
        options=options(combine=one_of("mean", "median")),
        weighs_prior=False,
    ),
    "drizzle": Method(
        "STScI drizzle: LR pixels shrunk and rained onto the HR grid",
        direct.drizzle,
        options=options("pixfrac", "kernel"),
        weighs_prior=False,
    ),
    "tikhonov": Method("least squares with squared neighbour differences; linear", sparse.tikhonov),
    "tv": Method(
        "least squares with total variation over eight neighbours",
        sparse.total_variation,
        options=options("iterations"),
    ),
    "l1-btv": Method(
        "Farsiu: L1 data term and bilateral total variation",
        bilateral.l1_btv,
        peak_of,
        options=options("window", "alpha", "iterations"),
    ),
    "map": Method(
        "maximum a posteriori: prior tv, huber or btv, data_term l2, l1 or huber",
        bilateral.maximum_a_posteriori,
        peak_of,
        options=options(
            "data_term", "window", "alpha", "threshold", "iterations", prior=one_of(*PRIORS)
        ),
    ),
    "irwsr": Method(
        "iteratively reweighted minimisation (Koehler), corrected, at the final scale",
        bilateral.irwsr,
        peak_of,
        options=options("window", "alpha", "sparsity", "iterations", "inner_iterations"),
    ),
    "irwsr-toolbox": Method(
        "the published toolbox step by step, its defects included",
        bilateral.irwsr_toolbox,
        peak_of,
        options=options("window", "alpha", "sparsity", "iterations", "inner_iterations"),
        take_level=False,
        keep_outside=True,
    ),
}


def method_names() -> tuple[str, ...]:
    """Return the names of all methods, the default first."""
    return tuple(METHODS)


def method_summary(name: str) -> str:
    """Return the one-line description of a method."""
    return find_method(name).summary


def find_method(name: str) -> Method:
    """Return a method by name.

    Raises
    ------
    ValueError
        If there is none of that name; the message lists them.
    """
    if name not in METHODS:
        raise ValueError(f"expected a method among {', '.join(METHODS)}, got {name!r}")
    return METHODS[name]
