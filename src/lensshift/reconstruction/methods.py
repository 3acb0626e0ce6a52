"""The methods that `reconstruct` knows, by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from lensshift.core.types import Estimate
from lensshift.reconstruction.classical import (
    Irwsr,
    IrwsrToolbox,
    L1Btv,
    MaximumPosterior,
    Tikhonov,
    Tv,
)
from lensshift.reconstruction.learned.method import auto
from lensshift.reconstruction.method import Method, Request
from lensshift.reconstruction.options import weight
from lensshift.reconstruction.plain import Bicubic, Deconvolution, Drizzle, Nearest, ShiftAndAdd
from lensshift.reconstruction.problem import Problem


@dataclass(frozen=True, slots=True)
class Auto(Method):
    """The unrolled solver of `lensshift.reconstruction.learned`."""

    name: ClassVar[str] = "auto"
    summary: ClassVar[str] = (
        "exact data steps and a learned prior, which needs no weight; the default"
    )
    undoes_lens: ClassVar[bool] = False

    def __call__(self, problem: Problem, request: Request) -> Estimate:
        """Return the estimate in units of the problem's intensity."""
        return auto(problem, request)


METHODS: Mapping[str, type[Method]] = {
    method.name: method
    for method in (
        Auto, Nearest, Bicubic, Deconvolution, ShiftAndAdd, Drizzle,
        Tikhonov, Tv, L1Btv, MaximumPosterior, Irwsr, IrwsrToolbox,
    )
}  # fmt: skip


def method_names() -> tuple[str, ...]:
    """Return the names of all methods, the default first."""
    return tuple(METHODS)


def find_method(name: str) -> type[Method]:
    """Return a method by name.

    Raises
    ------
    ValueError
        If there is none of that name; the message lists them.
    """
    if name not in METHODS:
        raise ValueError(f"expected a method among {', '.join(METHODS)}, got {name!r}")
    return METHODS[name]


def make_method(method: str | Method, options: Mapping[str, Any] | None = None) -> Method:
    """Return a method with its options, which are checked.

    Parameters
    ----------
    method : its name; or one that is made already and takes no more options
    options : its fields by name

    Raises
    ------
    ValueError
        If there is no such method, or it does not know an option or refuses its value: with the
        name of the option.
    """
    options = options or {}
    if isinstance(method, Method):
        if options:
            told = ", ".join(sorted(options))
            raise ValueError(f"{method.name} has its options already, got {told} beside it")
        return method
    kind = find_method(method)
    known = kind.option_names()
    unknown = sorted(set(options) - set(known))
    if "prior_weight" in unknown:
        told = options["prior_weight"]
        weight().check("prior_weight", told)
        raise ValueError(f"{method} has no prior to weigh, got prior_weight {told!r}")
    if unknown:
        names = ", ".join(known) or "none"
        raise ValueError(f"{method} does not know {', '.join(unknown)}; its options: {names}")
    return kind(**options)
