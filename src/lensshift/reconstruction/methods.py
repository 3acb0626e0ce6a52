"""The methods that `reconstruct` knows, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from lensshift.core.types import Estimate
from lensshift.reconstruction import bilateral, direct, sparse
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
    options : names of the keyword arguments of `reconstruct` that only this method knows
    """

    summary: str
    run: Run
    intensity: Callable[..., float] = brightness_of
    options: tuple[str, ...] = ()


METHODS: Mapping[str, Method] = {
    "auto": Method(
        "robust fit with a sparse prior whose weight sets itself from the noise; the default",
        sparse.auto,
        options=("iterations",),
    ),
    "nearest": Method(
        "one frame, each HR pixel from the nearest LR pixel", direct.nearest, options=("frame",)
    ),
    "bicubic": Method(
        "Keys' cubic interpolation of one frame, or mean or median of the aligned frames",
        direct.bicubic,
        options=("combine", "frame"),
    ),
    "deconvolution": Method(
        "one frame, interpolated and deconvolved by scikit-image",
        direct.deconvolution,
        options=("frame", "algorithm"),
    ),
    "shift-and-add": Method(
        "every LR sample dropped into the nearest HR pixel, holes filled",
        direct.shift_and_add,
        options=("combine",),
    ),
    "drizzle": Method(
        "STScI drizzle: LR pixels shrunk and rained onto the HR grid",
        direct.drizzle,
        options=("pixfrac", "kernel"),
    ),
    "tikhonov": Method("least squares with squared neighbour differences; linear", sparse.tikhonov),
    "tv": Method(
        "least squares with total variation over eight neighbours",
        sparse.total_variation,
        options=("iterations",),
    ),
    "l1-btv": Method(
        "Farsiu: L1 data term and bilateral total variation",
        bilateral.l1_btv,
        peak_of,
        options=("window", "alpha", "iterations"),
    ),
    "map": Method(
        "maximum a posteriori: prior tv, huber or btv, data_term l2, l1 or huber",
        bilateral.maximum_a_posteriori,
        peak_of,
        options=("prior", "data_term", "window", "alpha", "threshold", "iterations"),
    ),
    "irwsr": Method(
        "iteratively reweighted minimisation (Koehler), corrected, at the final scale",
        bilateral.irwsr,
        peak_of,
        options=("window", "alpha", "sparsity", "iterations", "inner_iterations"),
    ),
    "irwsr-toolbox": Method(
        "the published toolbox step by step, its defects included",
        bilateral.irwsr_toolbox,
        peak_of,
        options=("window", "alpha", "sparsity", "iterations", "inner_iterations"),
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
