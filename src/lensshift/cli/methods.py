"""`lensshift methods`, and what the words stand for that choose and set a method."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

import typer

from lensshift.cli.session import Session
from lensshift.cli.verbs import argument, verb


def _method_names() -> list[str]:
    from lensshift.reconstruction.methods import method_names

    return list(method_names())


MethodOption = Annotated[
    str, typer.Option(help="Method; `lensshift methods` lists them.", autocompletion=_method_names)
]
WeightOption = Annotated[
    str, typer.Option(help='Weight of the prior: a number, "auto" or "cross-validation".')
]
FramesOption = Annotated[
    str | None, typer.Option(help="Frames to use, as in 0,2,8,10; default: all.")
]


def check_method(method: str) -> None:
    """Raise a usage error that lists the methods if there is no such method."""
    names = _method_names()
    if method not in names:
        raise typer.BadParameter(f"there is no method {method!r}; choose among {', '.join(names)}")


def parse_weight(text: str) -> float | str | None:
    """Return a weight of the prior; None: found from the noise."""
    if text == "auto":
        return None
    if text == "cross-validation":
        return text
    try:
        weight = float(text)
    except ValueError:
        weight = -1.0
    if not 0.0 <= weight < float("inf"):
        problem = f'expected a number from 0, "auto" or "cross-validation", got {text!r}'
        raise typer.BadParameter(problem, param_hint="--prior-weight")
    return weight


def parse_options(method: str, told: list[str]) -> dict[str, Any]:
    """Return options of a method from texts NAME=VALUE; values as in TOML, or plain words."""
    from lensshift.core.errors import DataError
    from lensshift.core.settings import fitted, parse_toml
    from lensshift.reconstruction.methods import find_method, make_method

    options: dict[str, Any] = {}
    for text in told:
        name, equals, value = text.partition("=")
        if not equals or not name.isidentifier() or name == "prior_weight":
            hint = "; use --prior-weight" if name == "prior_weight" else ""
            problem = f"expected NAME=VALUE, got {text!r}{hint}"
            raise typer.BadParameter(problem, param_hint="--option")
        try:
            options[name] = parse_toml(f"value = {value}")["value"]
        except DataError:
            options[name] = value
    try:
        if not set(options) - set(find_method(method).option_names()):
            options = fitted(find_method(method), options, "")
        make_method(method, options)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--option") from error
    return options


def parse_frames(text: str | None) -> tuple[int, ...] | None:
    """Return the numbers of frames, None: all of them."""
    if text is None:
        return None
    parts = text.replace(" ", "").split(",")
    if not all(map(str.isdecimal, parts)) or len(set(parts)) < len(parts):
        problem = f"expected numbers as in 0,2,8,10, each once, got {text!r}"
        raise typer.BadParameter(problem, param_hint="--frames")
    return tuple(map(int, parts))


@dataclass(frozen=True, slots=True)
class _MethodsOptions:
    method: str | None = argument("Only this one.", default=None, metavar="METHOD")


@verb()
def methods(current: Session, asked: _MethodsOptions) -> None:
    """List the methods of reconstruction with their options.

    \b
    Examples:
      lensshift methods
      lensshift methods tv
      lensshift reconstruct burst.nc --method tv --option iterations=30
    """
    from lensshift.reconstruction.methods import METHODS

    if asked.method is not None:
        check_method(asked.method)
    chosen = {key: one for key, one in METHODS.items() if asked.method in (None, key)}
    width = max(map(len, chosen))
    for key, one in chosen.items():
        options = [
            {"name": known.name, "default": known.default,
             "expected": known.metadata["rule"].expected if "rule" in known.metadata else ""}
            for known in fields(one)
        ]  # fmt: skip
        current.result[key] = {"summary": one.summary, "options": options}
        current.say(f"{key:<{width}}  {one.summary}")
        for option in options:
            default = "found or chosen" if option["default"] is None else option["default"]
            current.say(f"{'':<{width}}    {option['name']}={default}  ({option['expected']})")
