"""What is wrong with data, as a value: what was found, what may have caused it, what to do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from testbed.arrays import Array

LISTED = 6
"""Most names in one line."""


@dataclass(frozen=True)
class Finding:
    """One thing that a person should look at.

    Attributes:
        subject: Which channel, joint or estimate.
        found: What is wrong with it, the number included.
        number: How much.
        causes: What may have caused it, the likeliest first.
        remedy: What to do.
    """

    subject: str
    found: str
    number: float
    causes: tuple[str, ...]
    remedy: str

    @property
    def text(self) -> str:
        """All in one line."""
        return in_lines([self])[0]


def in_lines(findings: Iterable[Finding]) -> list[str]:
    """Findings as text, one line for all that share causes and remedy."""
    groups: dict[tuple[tuple[str, ...], str], list[str]] = {}
    for each in findings:
        same = groups.setdefault((each.causes, each.remedy), [])
        same.append(f"{each.subject} {each.found}")
    return [
        f"{'; '.join(said)}; likely {', or '.join(causes)}; {remedy}"
        for (causes, remedy), said in groups.items()
    ]


def few(names: Sequence[str]) -> str:
    """The first names of a list, and how many there are more.

    Args:
        names: Of parameters, for example.
    """
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def components(vector: Array) -> str:
    """A vector as a person reads it.

    Args:
        vector: (k,).
    """
    return " ".join(f"{value:.4g}" for value in vector)
