"""Tables of instruments.md, from faults and effects themselves: `python -m docs.instruments`."""

from __future__ import annotations

from pathlib import Path

from docs.marks import write
from testbed.instruments import faults
from testbed.kind_table import in_words, rows
from testbed.simulation.effects import EFFECTS

DOCUMENT = Path(__file__).with_suffix(".md")
MODULE = "docs.instruments"


def as_markdown(of: str) -> str:
    """The tables of all faults, or of all effects.

    Args:
        of: Which of both.
    """
    if of == "faults":
        return faults.as_markdown()
    return "\n".join(["", *rows([in_words(effect) for effect in EFFECTS]), "", ""])


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown)
