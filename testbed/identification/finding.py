"""What is wrong with data, as a value: what was found, what may have caused it, what to do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array

ALIKE = 2
"""Most findings of one kind that are told in one line with their cause."""

GROSS = "residual"
"""Code of the symptom that small faults do not have."""

SYMPTOMS: Mapping[str, str] = {
    "negative-friction": "negative friction",
    GROSS: "large residuals",
    "no-rigid-bodies": "parameters that no rigid bodies have",
    "repetition": "residuals that repeat with the motion",
    "systematic-error": "errors beyond sigma",
    "prediction": "poor predictions of another motion",
}
"""Codes of findings that any cause may have, and what they are called beside it; without a cause
the first one is told."""


@dataclass(frozen=True)
class Finding:
    """One thing that a person should look at.

    Attributes:
        subject: Which channel, joint or estimate.
        found: What is wrong with it, the number included.
        number: How much.
        causes: What may have caused it, the likeliest first.
        remedy: What to do.
        code: Its kind, such as "torque-constant".
        method: Whose estimate it spoils; "" for that of plate and torques alike.
        support: Sigmas that speak for it; infinite where it is no matter of noise, and gross.
        alone: Whether it is the cause of no symptoms.
    """

    subject: str
    found: str
    number: float
    causes: tuple[str, ...]
    remedy: str
    code: str = ""
    method: str = ""
    support: float = np.inf
    alone: bool = False

    def explains(self, other: Finding) -> bool:
        """Whether another finding may be no more than a symptom of this one."""
        if other.code not in SYMPTOMS or self.alone or self.method not in ("", other.method):
            return False
        return other.code != GROSS or np.isinf(self.support)

    @property
    def text(self) -> str:
        """All in one line."""
        return in_lines([self])[0]


def in_lines(findings: Iterable[Finding]) -> list[str]:
    """Findings as text, one line for all that share causes and remedy."""
    groups: dict[tuple[tuple[str, ...], str], list[Finding]] = {}
    for each in findings:
        groups.setdefault((each.causes, each.remedy), []).append(each)
    return [_line(alike, len(alike)) for alike in groups.values()]


def folded(findings: Iterable[Finding]) -> list[str]:
    """Findings as text, a line a cause with the symptoms that it explains.

    The cause for which most speaks comes first. Symptoms that no cause explains stand under the
    first of themselves.

    Args:
        findings: Of one recording, by one method or by both.
    """
    rank = {code: k for k, code in enumerate(SYMPTOMS, start=1)}
    every = sorted(dict.fromkeys(findings), key=lambda f: (rank.get(f.code, 0), -f.support))
    leaders: list[Finding] = []
    alike: dict[tuple[tuple[str, ...], str], list[Finding]] = {}
    under: dict[tuple[tuple[str, ...], str], dict[str, None]] = {}
    for each in every:
        leader = next((one for one in leaders if one.explains(each)), each)
        key, own = (leader.causes, leader.remedy), (each.causes, each.remedy)
        if key == own:
            alike.setdefault(own, []).append(each)
            leaders.append(each)
        else:
            under.setdefault(key, {})[SYMPTOMS[each.code]] = None
    lines = []
    for key, group in sorted(alike.items(), key=lambda item: -item[1][0].support):
        also = ", ".join(under.get(key, ()))
        lines.append(_line(group, ALIKE) + (f"; this explains {also}" if also else ""))
    return lines


def _line(alike: Sequence[Finding], most: int) -> str:
    """Findings that share causes and remedy; of many some are told and all are counted."""
    said = [f"{each.subject} {each.found}" for each in alike[:most]]
    said += [f"and {len(alike) - most} more like it"] * (len(alike) > most)
    return f"{'; '.join(said)}; likely {', or '.join(alike[0].causes)}; {alike[0].remedy}"


def components(vector: Array) -> str:
    """A vector as a person reads it.

    Args:
        vector: (k,).
    """
    return " ".join(f"{value:.4g}" for value in vector)
