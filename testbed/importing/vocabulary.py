"""Tables of words, loggers, formats and hypotheses, as files beside this module list them."""

from __future__ import annotations

from importlib.resources import files
from tomllib import loads
from typing import Any


def read_table(name: str) -> dict[str, Any]:
    """Content of a table beside this module.

    Args:
        name: Of the file, without its ending.
    """
    return loads(files("testbed.importing").joinpath(f"{name}.toml").read_text("utf-8"))


TABLES = read_table("vocabulary")
"""Lists of words by what they say."""


def by_word(table: str) -> dict[str, str]:
    """Keys of a table by their words.

    Args:
        table: As "symbols", whose keys are quantities.
    """
    return {word: key for key, words in TABLES[table].items() for word in words}
