"""`lensshift methods`: what can be chosen with --method, and what each one can be told."""

from __future__ import annotations

from dataclasses import dataclass, fields

from lensshift.cli.session import Session
from lensshift.cli.verbs import argument, verb


@dataclass(frozen=True, slots=True)
class MethodsOptions:
    """Options of `lensshift methods`."""

    method: str | None = argument("Only this one.", default=None, metavar="METHOD")


@verb()
def methods(current: Session, asked: MethodsOptions) -> None:
    """List the methods of reconstruction with their options.

    \b
    Examples:
      lensshift methods
      lensshift methods tv
      lensshift reconstruct burst.nc --method tv --option iterations=30
    """
    from lensshift.cli.method_options import check_method
    from lensshift.reconstruction.methods import METHODS

    if asked.method is not None:
        check_method(asked.method)
    chosen = {key: one for key, one in METHODS.items() if asked.method in (None, key)}
    width = max(map(len, chosen))
    for key, one in chosen.items():
        options = [
            {
                "name": known.name,
                "default": known.default,
                "expected": known.metadata["rule"].expected if "rule" in known.metadata else "",
            }
            for known in fields(one)
        ]
        current.result[key] = {"summary": one.summary, "options": options}
        current.say(f"{key:<{width}}  {one.summary}")
        for option in options:
            default = "found or chosen" if option["default"] is None else option["default"]
            current.say(f"{'':<{width}}    {option['name']}={default}  ({option['expected']})")
