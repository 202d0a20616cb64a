"""How the project refuses: one clear line that names what is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

LONGEST = 300
"""Characters of a message that a person reads, folders of its paths not counted."""


@contextmanager
def refuses(kind: type[Exception], *culprits: str) -> Iterator[None]:
    """What is done inside must be refused.

    Args:
        kind: Of the error.
        culprits: What its message must name: a key, a joint, a file, a value.
    """
    with pytest.raises(kind) as refusal:
        yield
    text = str(refusal.value)
    assert is_message(text), text
    assert [each for each in culprits if each not in text] == [], text


def is_message(text: str) -> bool:
    """Whether a text is one line of a length that a person reads, without a stack."""
    short = re.sub(r"(?<!\S)/\S*/", "", text)
    return 0 < len(short) <= LONGEST and "\n" not in text and "Traceback" not in text
