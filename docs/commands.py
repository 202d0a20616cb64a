"""Every command with its options, from the commands themselves: `python -m docs.commands`."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

from docs.marks import prose, table, write

DOCUMENT = Path(__file__).with_suffix(".md")
TEMPLATE = DOCUMENT.parent / "templates" / DOCUMENT.name
MODULE = "docs.commands"


def as_markdown(of: str = "") -> str:
    """All commands, in the order of their names.

    Args:
        of: Nothing: there is one place.
    """
    del of
    import typer

    from testbed.cli.commands import app

    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    lines = []
    for name, command in sorted(commands.items()):
        context = typer.Context(command, info_name=f"testbed {name}")
        pieces = [piece.strip("{}") for piece in command.collect_usage_pieces(context)]
        usage = " ".join([f"testbed {name}", *pieces])
        lines += ["", f"## {name}", "", f"**`{usage}`**", "", *said(command.help or "")]
        records = [each.get_help_record(context) for each in command.params]
        rows = [(f"`{option}`", described(words)) for option, words in filter(None, records)]
        lines += ["", *table("argument or option | meaning", rows)]
    return "\n".join([*lines, "", ""])


def said(text: str) -> list[str]:
    """A command's own words: paragraphs, and examples as they are typed."""
    lines = inspect.cleandoc(text.replace("\b", "")).split("\n")
    return [prose(re.sub(r"^Example: (.*)", r"Example: `\1`", line)) for line in lines]


def described(text: str) -> str:
    """An option's meaning, its default in words."""
    text = " ".join(text.split())
    return re.sub(r" ?\\\[(default: [^\]]*?|required)\\\]", r" (\1)", prose(text))


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown, TEMPLATE)
