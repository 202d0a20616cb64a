"""What is wrong with data, as a value: what was found, what may have caused it, what to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


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
