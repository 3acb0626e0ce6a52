"""Verbs made from their settings, and groups of verbs, whose help says what each does in full.

A verb is a function of a session and of one frozen dataclass, whose fields are its options:

    @dataclass(frozen=True, slots=True)
    class Asked:
        scan: Path = argument("Burst file of a scan.", metavar="SCAN")
        noise: float = option(0.005, "Noise of a pixel / full scale.", min=1e-6)
        stack: StackOptions = field(default_factory=StackOptions)  # that verbs have in common

    @verb("calibrating")
    def calibrate(current: Session, asked: Asked) -> None: ...
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, field, fields, is_dataclass
from inspect import Parameter, Signature
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperGroup

from lensshift.cli.ranges import checked
from lensshift.cli.session import DebugOption, JsonOption, Session, session

_MOST_CHARACTERS = 1000  # none of ours is cut; the formatter breaks lines


def option(default: Any, help: str, *names: str, **rules: Any) -> Any:
    """Return a field that the command line sets by `--its-name`, or by `names` such as "-o".

    The default of a list is None, MISSING that of an option that must be given; `rules` are those
    of `typer.Option`.
    """
    return field(default=default, metadata={"told": (typer.Option, names, {"help": help, **rules})})


def argument(help: str, **rules: Any) -> Any:
    """Return a field that the command line sets by its place; required without `default`."""
    default = {"default": rules.pop("default")} if "default" in rules else {}
    return field(**default, metadata={"told": (typer.Argument, (), {"help": help, **rules})})


def verb(
    doing: str = "", *, json: Any = JsonOption
) -> Callable[[Callable[[Session, Any], None]], Callable[..., None]]:
    """Make a verb of a function of a session and its options, `asked`; `doing` as in `session`."""

    def made(body: Callable[[Session, Any], None]) -> Callable[..., None]:
        asked = get_type_hints(body)["asked"]

        def run(*, as_json: bool, debug: bool, **given: Any) -> None:
            with session(as_json=as_json, debug=debug, doing=doing) as current:
                body(current, _filled(asked, given))

        common = [_parameter("as_json", json, False), _parameter("debug", DebugOption, False)]
        signature = Signature([*_parameters(asked), *common])
        run.__signature__ = signature  # type: ignore[attr-defined]  # what typer looks at
        run.__name__, run.__doc__ = body.__name__, body.__doc__
        return run

    return made


def _parameters(asked: type[Any]) -> Iterator[Parameter]:
    """Yield a parameter for each field, and for those of a field that is a dataclass itself."""
    hints = get_type_hints(asked, include_extras=True)
    for one in fields(asked):
        kind = hints[one.name]
        if isinstance(kind, type) and is_dataclass(kind):
            yield from _parameters(kind)
            continue
        if "told" in one.metadata:
            make, names, rules = one.metadata["told"]
            if make is typer.Option and not any(name.startswith("--") for name in names):
                names = (f"--{one.name.replace('_', '-')}", *names)
            kind = Annotated[kind, make(*names, **rules)]
        yield _parameter(one.name, kind, Parameter.empty if one.default is MISSING else one.default)


def _parameter(name: str, kind: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def _filled(asked: type[Any], given: Mapping[str, Any]) -> Any:
    """Return the dataclass with what was given on the command line."""
    hints = get_type_hints(asked)
    return asked(**{
        one.name: _filled(hints[one.name], given) if is_dataclass(hints[one.name])
        else checked(one.name, given[one.name])
        for one in fields(asked)
    })  # fmt: skip


class FullHelp(TyperGroup):
    """A group that does not cut the descriptions of its verbs to one line."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the verbs and their first sentences."""
        names = self.list_commands(ctx)
        verbs = [one for name in names if (one := self.get_command(ctx, name)) and not one.hidden]
        rows = [(str(one.name), one.get_short_help_str(_MOST_CHARACTERS)) for one in verbs]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def verb_group(**options: Any) -> typer.Typer:
    """Return an empty group of verbs in plain text, with full help."""
    return typer.Typer(cls=FullHelp, no_args_is_help=True, rich_markup_mode=None, **options)
