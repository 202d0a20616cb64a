"""What is wrong with data, as a value: what was found, what may have caused it, what to do."""

from __future__ import annotations

from collections.abc import Sequence
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
        return together([self])


def together(findings: Sequence[Finding]) -> str:
    """Findings that share causes and remedy, in one line."""
    said = "; ".join(f"{each.subject} {each.found}" for each in findings)
    return f"{said}; likely {', or '.join(findings[0].causes)}; {findings[0].remedy}"
