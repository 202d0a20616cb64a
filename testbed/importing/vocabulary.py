"""Tables of words, loggers, formats and hypotheses, read from TOML files next to this module."""

from __future__ import annotations

from importlib.resources import files
from tomllib import loads
from typing import Any


def read_table(name: str) -> dict[str, Any]:
    """Content of a TOML file in the folder of this module.

    Args:
        name: File name without the extension.
    """
    return loads(files("testbed.importing").joinpath(f"{name}.toml").read_text("utf-8"))


WORD_TABLES = read_table("vocabulary")
"""Words in names of columns and units, by topic."""


def keys_by_word(table: str) -> dict[str, str]:
    """Invert a table of words: map each word to its key.

    Args:
        table: Name of the table, for example "symbols", whose keys are quantities.
    """
    return {word: key for key, words in WORD_TABLES[table].items() for word in words}
