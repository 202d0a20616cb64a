"""The table of plants.md made anew, from the effects themselves: `python -m docs.plants`."""

from __future__ import annotations

from pathlib import Path

from docs.instruments import between_marks
from testbed.kind_table import in_words, rows
from testbed.simulation.effects import EFFECTS

DOCUMENT = Path(__file__).with_suffix(".md")
BEGIN = "<!-- written by python -m docs.plants -->\n"


def as_markdown() -> str:
    """A table of all effects."""
    return "\n".join(["", *rows([in_words(effect) for effect in EFFECTS]), "", ""])


if __name__ == "__main__":
    between_marks(DOCUMENT, BEGIN, as_markdown())
