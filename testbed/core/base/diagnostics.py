"""Diagnostics of results, represented as values; their wording is in `messages.toml`.

The level "error" means that data and model contradict each other, so that standard deviations are
not valid. A "warning" describes a limitation of the result, an "info" a processing step.
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

MAX_QUOTED = 2
"""Largest number of diagnostics quoted in full that share code, causes and remedy."""


@dataclass(frozen=True)
class Diagnostic:
    """Finding about a result: code, text, level, size, likely causes and remedy.

    Attributes:
        code: Kind of finding, such as "plate.tare": a key of the message table.
        text: Statement of the finding, with numbers.
        level: Severity.
        subject: Channel, joint, parameter or file concerned.
        value: Size of the finding, in the unit given in the text.
        sigma: Standard deviation of `value`.
        significance: Size of the finding in standard deviations of the noise; None if noise cannot
            cause it.
        method: Method whose estimate is affected, "wrench" or "torque"; "" for all methods.
        causes: Codes of the likely causes, or phrases; the most likely cause comes first.
        remedy: Recommended action.
        follows: Code of the diagnostic of which this diagnostic is a symptom; "" for none.
        recording: Name of the recording; "" if there is only one recording.
        instrument: Name of the force sensor concerned; "" for the force plate.
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
        return ". ".join(_group_text([self], ()))

    def explains(self, other: Diagnostic) -> bool:
        """True if another diagnostic may be a symptom of this diagnostic.

        The other message must have a symptom name, and this message must not be marked `alone`.
        The recordings must be equal, and so must the methods, unless this method is "". A symptom
        marked `gross` also requires that this diagnostic has no significance.
        """
        message, symptom = _message(self.code), _message(other.code).symptom
        if not symptom or message.alone or self.method not in ("", other.method):
            return False
        if self.recording != other.recording:
            return False
        return not _message(other.code).gross or self.significance is None

    def as_dict(self) -> dict[str, Any]:
        """Fields as a dictionary of JSON values."""
        return {
            k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()
        }


class Message(NamedTuple):
    """Wording of one kind of diagnostic, from one table of `messages.toml`.

    Attributes:
        text: Statement, with replacement fields of `str.format`.
        level: Severity of the diagnostic.
        causes: Codes of likely causes.
        remedy: Recommended action, with replacement fields.
        optional: Additions to the text, keyed by field name, used if the field is not empty.
        symptom: Name of the finding as a symptom of another diagnostic; "" for a cause.
        gross: True for a symptom that only gross faults have.
        alone: True if the diagnostic has no symptoms.
        rank: Order among symptoms; if no cause is present, the first symptom replaces the cause.
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


def make_diagnostic(
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
    """Create a diagnostic with the wording of the message table.

    Args:
        code: Key of the table, GROUP.NAME; a code that is not in the table gets the wording of
            GROUP.other.
        subject: Channel, joint, parameter or file concerned.
        value: Size of the finding; `value`, `sigma` and `significance` become None if not finite.
        sigma: Standard deviation of `value`.
        significance: Size in standard deviations of the noise.
        method: Method whose estimate is affected.
        level: Severity; by default that of the table.
        causes: Codes of likely causes; by default those of the table.
        **details: Values of further fields of the wording; for a value that is not empty, the
            optional addition of the same name is appended to the text.
    """
    message = _message(code)
    numbers = {"value": value, "sigma": sigma, "significance": significance}
    field_values = {"subject": subject, "method": method, **numbers, **details}
    additions = (part for name, part in message.optional.items() if details.get(name))
    return Diagnostic(
        code=code,
        text="".join([message.text, *additions]).format(**field_values),
        level=level or message.level,
        subject=subject,
        value=_finite_or_none(value),
        sigma=_finite_or_none(sigma),
        significance=_finite_or_none(significance),
        method=method,
        causes=message.causes if causes is None else tuple(causes),
        remedy=message.remedy.format(**field_values),
    )


_PLATE = re.compile(r"(?<![-\w])(force )?plate(?!\w)")
"""Pattern that matches the name of the force plate in a sentence."""


def worded_for_sensor(
    diagnostics: Iterable[Diagnostic], name: str
) -> tuple[Diagnostic, ...]:
    """Diagnostics with the name of a force sensor in place of "plate" in the texts.

    Args:
        diagnostics: Diagnostics with the wording of the table.
        name: Name of the sensor; "" for the plate.
    """
    if not name:
        return tuple(diagnostics)
    return tuple(
        replace(
            diagnostic,
            text=_PLATE.sub(name, diagnostic.text),
            subject=_PLATE.sub(name, diagnostic.subject),
            remedy=_PLATE.sub(name, diagnostic.remedy),
            instrument=name,
        )
        for diagnostic in diagnostics
    )


def ordered_diagnostics(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Order diagnostics: causes by decreasing significance, then symptoms, then warnings and infos.

    Causes and symptoms are of level "error". A missing significance is treated as infinite. The
    field `follows` of each symptom is set to the code of the first cause that explains it
    (`explains`). If there is no cause, the symptom that comes first in the message table is taken
    as the cause of the others. Duplicates are removed.

    Args:
        diagnostics: Diagnostics of one recording, of one or both methods.
    """
    distinct = dict.fromkeys(replace(each, follows="") for each in diagnostics)
    causes: list[Diagnostic] = []
    symptoms: list[Diagnostic] = []
    errors = [each for each in distinct if each.level == "error"]
    for each in sorted(
        errors, key=lambda d: (_message(d.code).rank, -_significance(d))
    ):
        leader = next((cause for cause in causes if cause.explains(each)), each)
        if _group_key(leader) == _group_key(each):
            causes.append(each)
        else:
            symptoms.append(replace(each, follows=leader.code))
    causes.sort(key=lambda d: -_significance(d))
    return (*causes, *symptoms, *(each for each in distinct if each.level != "error"))


def sentences(diagnostics: Iterable[Diagnostic]) -> tuple[str, ...]:
    """Texts of diagnostics, one line per group of similar diagnostics.

    A line consists of the parts from `diagnostic_paragraphs`, separated by full stops.

    Args:
        diagnostics: Ordered diagnostics.
    """
    return tuple(". ".join(parts) for parts in diagnostic_paragraphs(diagnostics))


def diagnostic_paragraphs(
    diagnostics: Iterable[Diagnostic],
) -> tuple[tuple[str, ...], ...]:
    """Parts of each group's text: findings, likely causes, symptoms, remedy.

    Diagnostics with the same code, recording, instrument, level, causes and remedy form a group. If
    there are no causes and no remedy, the texts must also be equal. Symptoms are listed with the
    first group of their cause.

    Args:
        diagnostics: Ordered diagnostics.
    """
    entries = list(diagnostics)
    causes = {each.code for each in entries if not each.follows}
    groups: dict[tuple[str, ...], list[Diagnostic]] = {}
    symptoms: dict[str, dict[str, None]] = {}
    for each in entries:
        if each.follows in causes:
            symptoms.setdefault(each.follows, {})[_message(each.code).symptom] = None
        else:
            groups.setdefault(_group_key(each), []).append(each)
    first = {group[0].code: group for group in reversed(groups.values())}
    return tuple(
        _group_text(
            group,
            symptoms.get(group[0].code, ()) if first[group[0].code] is group else (),
        )
        for group in groups.values()
    )


def diagnostics_from_json(content: Any) -> tuple[Diagnostic, ...]:
    """Diagnostics from tables written by `Diagnostic.as_dict`.

    Args:
        content: List of tables with at least code and text.

    Raises:
        ValueError: The content has another form.
    """
    from testbed.core.base.codec import from_json_values  # loads NumPy

    return tuple(from_json_values(list[Diagnostic], content, {}))


class Diagnosed:
    """Base class of results with diagnostics."""

    if TYPE_CHECKING:

        @property
        def diagnostics(self) -> tuple[Diagnostic, ...]:
            """Findings about the result."""

    @property
    def has_errors(self) -> bool:
        """True if data and model contradict each other, so that sigmas are not valid."""
        return any(each.level == "error" for each in self.diagnostics)


@cache
def message_table() -> Mapping[str, Message]:
    """Message table: wording of each kind of diagnostic, keyed by code GROUP.NAME.

    Keys directly under a group apply to all messages of the group. Symptoms are ranked in the order
    of the file.
    """
    by_code: dict[str, Message] = {}
    rank = 0
    for group, table in _message_file().items():
        common = {
            key: entry for key, entry in table.items() if not isinstance(entry, dict)
        }
        for name, own in table.items() if group != "causes" else ():
            if isinstance(own, dict):
                arguments = common | own
                rank += "symptom" in arguments
                arguments["causes"] = tuple(arguments.get("causes", ()))
                arguments["rank"] = rank * ("symptom" in arguments)
                by_code[f"{group}.{name}"] = Message(**arguments)
    return by_code


def cause_phrase(cause: str, instrument: str = "") -> str:
    """Phrase for a likely cause, from the table of causes.

    Args:
        cause: Code of the cause; if it is not in the table, a phrase or words joined by
            underscores.
        instrument: Name of the force sensor, which replaces "plate"; "" for the plate.
    """
    words = cause.replace("_", " ") if cause.isidentifier() else cause
    text = str(_message_file()["causes"].get(cause, words))
    return _PLATE.sub(instrument, text) if instrument else text


@cache
def _message_file() -> Mapping[str, Any]:
    """Parsed content of `messages.toml`."""
    return loads(
        files("testbed.core.base").joinpath("messages.toml").read_text("utf-8")
    )


def _message(code: str) -> Message:
    """Message of a code; for unknown codes the group's message "other", or an empty message."""
    other = f"{code.partition('.')[0]}.other"
    return message_table().get(code, message_table().get(other, Message("")))


def _group_key(each: Diagnostic) -> tuple[str, ...]:
    """Key that is equal for diagnostics of one group (`diagnostic_paragraphs`)."""
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


def _group_text(group: list[Diagnostic], symptoms: Iterable[str]) -> tuple[str, ...]:
    """Texts, likely causes, symptoms and remedy of a group of similar diagnostics.

    The first `MAX_QUOTED` texts are quoted; of the others, only the number is given.
    """
    first, texts = group[0], [each.text for each in group[:MAX_QUOTED]]
    texts += [f"and {len(group) - MAX_QUOTED} similar"] * (len(group) > MAX_QUOTED)
    text = f"{first.recording}: " * bool(first.recording) + "; ".join(texts)
    labels = {
        "Likely cause": ", or ".join(
            cause_phrase(each, first.instrument) for each in first.causes
        ),
        "Consequence": ", ".join(symptoms),
        "Remedy": first.remedy,
    }
    return (
        text,
        *(
            f"{label}: {text_of_label}"
            for label, text_of_label in labels.items()
            if text_of_label
        ),
    )


def _significance(each: Diagnostic) -> float:
    """Significance for sorting; infinite if the diagnostic has no significance."""
    return math.inf if each.significance is None else each.significance


def _finite_or_none(value: float | None) -> float | None:
    """Number as a float; None if the number is absent or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)
