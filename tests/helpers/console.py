"""What is printed on a terminal of some width."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from typing import Any

from rich.console import Console


def printed(width: int, print_it: Callable[..., object], *words: Any) -> str:
    """The text of something that prints.

    Args:
        width: Of the terminal.
        print_it: Takes a console, then the words.
        words: What it prints.
    """
    console = Console(markup=False, width=width, record=True, file=StringIO())
    print_it(console, *words)
    return console.export_text()
