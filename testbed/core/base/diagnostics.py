"""All that a result says to a person, as values; their sentences are in `messages.toml`.

Errors say that data and model contradict each other, so that standard deviations do not hold;
warnings, what limits a result; infos, what was done.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from tomllib import loads
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

Level = Literal["error", "warning", "info"]

ALIKE = 2
"""Most diagnostics of one code, causes and remedy that have a sentence each."""


@dataclass(frozen=True)
class Diagnostic:
    """One thing that a person should know of a result.

    Attributes:
        code: Its kind, such as "plate.tare": a key of the table of messages.
        text: What is the case, numbers included.
        level: How grave it is.
        subject: Which channel, joint, parameter or file.
        value: The number that it is about, in the unit that the text names.
        sigma: Its standard deviation.
        significance: Standard deviations beyond which it is no noise; None where it is no matter
            of noise.
        method: Of the estimate that it spoils; "" for all.
        causes: Codes of the likely causes, the likeliest first; or phrases.
        remedy: What to do.
        follows: Code of the diagnostic that explains it.
        recording: Name of the recording, where there are several.
        instrument: The force sensor that it is of; "" where that is the plate.
    """

    code: str
    text: str
    level: Level = "warning"
    subject: str = ""
    value: float | None = None
    sigma: float | None = None
    significance: float | None = None
    method: str = ""
    causes: tuple[str, ...] = ()
    remedy: str = ""
    follows: str = ""
    recording: str = ""
    instrument: str = ""

    def __str__(self) -> str:
        return ". ".join(_parts([self], ()))

    def explains(self, other: Diagnostic) -> bool:
        """Whether another one may be no more than a symptom of this one."""
        message, symptom = _message(self.code), _message(other.code).symptom
        if not symptom or message.alone or self.method not in ("", other.method):
            return False
        if self.recording != other.recording:
            return False
        return not _message(other.code).gross or self.significance is None

    def as_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()
        }


class Message(NamedTuple):
    """How a kind of diagnostic is worded.

    Attributes:
        text: With fields of `str.format`.
        level: As of the diagnostic.
        causes: Codes of likely causes.
        remedy: What to do, with fields.
        optional: By name of a field: what is added to the text where that is not empty.
        symptom: What it is called beside a diagnostic that explains it; "" for what is a cause.
        gross: Whether it is a symptom of gross faults only.
        alone: Whether it explains no symptoms.
        rank: Of symptoms: the first one stands for all where none is explained.
    """

    text: str
    level: Level = "warning"
    causes: tuple[str, ...] = ()
    remedy: str = ""
    optional: Mapping[str, str] = {}
    symptom: str = ""
    gross: bool = False
    alone: bool = False
    rank: int = 0


def diagnose(
    code: str,
    subject: str = "",
    value: float | None = None,
    *,
    sigma: float | None = None,
    significance: float | None = None,
    method: str = "",
    level: Level | None = None,
    causes: Iterable[str] | None = None,
    **details: Any,
) -> Diagnostic:
    """A diagnostic, worded by the table of messages.

    Args:
        code: A key of the table.
        subject: As of the diagnostic.
        value: As of the diagnostic; numbers that are not finite are dropped.
        sigma: As of the diagnostic.
        significance: As of the diagnostic.
        method: As of the diagnostic.
        level: Default the table's.
        causes: Default the table's.
        details: What else its sentences hold.
    """
    message = _message(code)
    numbers = {"value": value, "sigma": sigma, "significance": significance}
    shown = {"subject": subject, "method": method, **numbers, **details}
    more = (part for name, part in message.optional.items() if details.get(name))
    return Diagnostic(
        code=code,
        text="".join([message.text, *more]).format(**shown),
        level=level or message.level,
        subject=subject,
        value=_finite(value),
        sigma=_finite(sigma),
        significance=_finite(significance),
        method=method,
        causes=message.causes if causes is None else tuple(causes),
        remedy=message.remedy.format(**shown),
    )


_PLATE = re.compile(r"(?<![-\w])(force )?plate(?!\w)")


def of_instrument(
    diagnostics: Iterable[Diagnostic], name: str
) -> tuple[Diagnostic, ...]:
    """The same of another force sensor: its name stands where sentences say "plate".

    Args:
        diagnostics: As the table words them.
        name: Of the sensor; "" for the plate.
    """
    if not name:
        return tuple(diagnostics)
    return tuple(
        replace(
            each,
            text=_PLATE.sub(name, each.text),
            subject=_PLATE.sub(name, each.subject),
            remedy=_PLATE.sub(name, each.remedy),
            instrument=name,
        )
        for each in diagnostics
    )


def ordered(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Errors first, the most significant cause before others, symptoms marked and behind.

    None stands twice. Symptoms that nothing explains follow from the first of themselves.

    Args:
        diagnostics: Of one recording, by one method or by both.
    """
    every = dict.fromkeys(replace(each, follows="") for each in diagnostics)
    causes: list[Diagnostic] = []
    symptoms: list[Diagnostic] = []
    errors = [each for each in every if each.level == "error"]
    for each in sorted(
        errors, key=lambda d: (_message(d.code).rank, -_significance(d))
    ):
        leader = next((cause for cause in causes if cause.explains(each)), each)
        if _kind(leader) == _kind(each):
            causes.append(each)
        else:
            symptoms.append(replace(each, follows=leader.code))
    causes.sort(key=lambda d: -_significance(d))
    return (*causes, *symptoms, *(each for each in every if each.level != "error"))


def sentences(diagnostics: Iterable[Diagnostic]) -> tuple[str, ...]:
    """As a person reads them in a line each: see `paragraphs`.

    Args:
        diagnostics: In order.
    """
    return tuple(". ".join(parts) for parts in paragraphs(diagnostics))


def paragraphs(diagnostics: Iterable[Diagnostic]) -> tuple[tuple[str, ...], ...]:
    """What was found, the likely causes, the symptoms that follow, the remedy; each a sentence.

    Args:
        diagnostics: In order.
    """
    every = list(diagnostics)
    causes = {each.code for each in every if not each.follows}
    groups: dict[tuple[str, ...], list[Diagnostic]] = {}
    symptoms: dict[str, dict[str, None]] = {}
    for each in every:
        if each.follows in causes:
            symptoms.setdefault(each.follows, {})[_message(each.code).symptom] = None
        else:
            groups.setdefault(_kind(each), []).append(each)
    first = {group[0].code: group for group in reversed(groups.values())}
    return tuple(
        _parts(
            group,
            symptoms.get(group[0].code, ()) if first[group[0].code] is group else (),
        )
        for group in groups.values()
    )


def from_json(content: Any) -> tuple[Diagnostic, ...]:
    """Diagnostics of tables as `as_dict` makes them.

    Args:
        content: A list of tables with at least code and text.

    Raises:
        ValueError: It is something else.
    """
    from testbed.core.base.codec import decode  # loads NumPy

    return tuple(decode(list[Diagnostic], content, {}))


class Diagnosed:
    """What has diagnostics."""

    if TYPE_CHECKING:

        @property
        def diagnostics(self) -> tuple[Diagnostic, ...]:
            """What a careful reader should know."""

    @property
    def doubtful(self) -> bool:
        """Whether data and model contradict each other: standard deviations do not hold then."""
        return any(each.level == "error" for each in self.diagnostics)


@cache
def messages() -> Mapping[str, Message]:
    """The table of messages, by code."""
    found: dict[str, Message] = {}
    rank = 0
    for group, table in _table().items():
        common = {
            key: said for key, said in table.items() if not isinstance(said, dict)
        }
        for name, own in table.items() if group != "causes" else ():
            if isinstance(own, dict):
                given = common | own
                rank += "symptom" in given
                given["causes"] = tuple(given.get("causes", ()))
                given["rank"] = rank * ("symptom" in given)
                found[f"{group}.{name}"] = Message(**given)
    return found


def phrase(cause: str, instrument: str = "") -> str:
    """What a cause is called.

    Args:
        cause: Its code, or the phrase itself.
        instrument: As of the diagnostic.
    """
    words = cause.replace("_", " ") if cause.isidentifier() else cause
    said = str(_table()["causes"].get(cause, words))
    return _PLATE.sub(instrument, said) if instrument else said


@cache
def _table() -> Mapping[str, Any]:
    return loads(
        files("testbed.core.base").joinpath("messages.toml").read_text("utf-8")
    )


def _message(code: str) -> Message:
    """Message of a code; for an unknown code that of its group's "other", or an empty one."""
    other = f"{code.partition('.')[0]}.other"
    return messages().get(code, messages().get(other, Message("")))


def _kind(each: Diagnostic) -> tuple[str, ...]:
    """What diagnostics have in common that share a sentence."""
    own = () if each.causes or each.remedy else (each.text,)
    return (
        each.code,
        each.recording,
        each.instrument,
        each.level,
        each.remedy,
        *own,
        *each.causes,
    )


def _parts(group: list[Diagnostic], symptoms: Iterable[str]) -> tuple[str, ...]:
    """Diagnostics of one kind: of many the first ones are given and all are counted."""
    first, shown = group[0], [each.text for each in group[:ALIKE]]
    shown += [f"and {len(group) - ALIKE} similar"] * (len(group) > ALIKE)
    text = f"{first.recording}: " * bool(first.recording) + "; ".join(shown)
    labels = {
        "Likely cause": ", or ".join(
            phrase(each, first.instrument) for each in first.causes
        ),
        "Consequence": ", ".join(symptoms),
        "Remedy": first.remedy,
    }
    return (text, *(f"{label}: {said}" for label, said in labels.items() if said))


def _significance(each: Diagnostic) -> float:
    return math.inf if each.significance is None else each.significance


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
