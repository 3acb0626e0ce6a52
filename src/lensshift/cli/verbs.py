"""Groups of verbs, whose help says what each verb does in full."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

_MOST_CHARACTERS = 1000  # none of ours is cut; the formatter breaks lines


class FullHelp(TyperGroup):
    """A group that does not cut the descriptions of its verbs to one line."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the verbs and their first sentences."""
        verbs = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        rows = [
            (name, verb.get_short_help_str(_MOST_CHARACTERS))
            for name, verb in verbs.items()
            if verb is not None and not verb.hidden
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def verb_group(**options: Any) -> typer.Typer:
    """Return an empty group of verbs in plain text, with full help."""
    return typer.Typer(cls=FullHelp, no_args_is_help=True, rich_markup_mode=None, **options)
