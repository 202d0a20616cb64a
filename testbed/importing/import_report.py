"""What an import found: every source's clock, every signal's samples, and what to doubt."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from testbed.core.base.codec import decode
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import plural, printable
from testbed.importing.source_clock import ClockReport

LONGEST = 300
"""Characters of a note that quotes names of files and columns."""


@dataclass(frozen=True)
class MappingDraft:
    """Draft of a mapping file: tables, notes beside keys, comments above tables.

    Attributes:
        tables: By dotted name, that of the keys without a table being empty: keys and values.
        notes: By table and key, what is said beside it.
        remarks: Lines of comment above a table, or in place of one that is not there.
    """

    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: Mapping[tuple[str, str], str] = field(default_factory=dict)
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def saying(self, table: str, key: str, value: Any, note: str = "") -> MappingDraft:
        """The same with another value of a key, and another note beside it; None takes it out.

        Args:
            table: Its dotted name.
            key: Of the table.
            value: Number, text, list or table.
            note: One line; none if that is empty.
        """
        given = {**self.tables.get(table, {}), key: value}
        keys = {name: each for name, each in given.items() if each is not None}
        notes = {
            place: each for place, each in self.notes.items() if place != (table, key)
        }
        notes |= {(table, key): note} if note and value is not None else {}
        return replace(self, tables={**self.tables, table: keys}, notes=notes)

    def saying_all(
        self, table: str, keys: Iterable[tuple[str, Any, str]]
    ) -> MappingDraft:
        """The same with keys of a table, their values and notes."""
        draft = self
        for key, value, note in keys:
            draft = draft.saying(table, key, value, note)
        return draft

    def remarking(self, table: str, *lines: str) -> MappingDraft:
        """The same with lines of comment above a table, or in place of one that is not there."""
        said = [*self.remarks.get(table, ()), *lines]
        return replace(
            self,
            tables={**self.tables, table: self.tables.get(table, {})},
            remarks={**self.remarks, table: said},
        )

    @property
    def content(self) -> dict[str, Any]:
        """As TOML would be read; a key that begins with # is a comment."""
        found: dict[str, Any] = {}
        for name, keys in self.tables.items():
            here = found
            for part in name.split(".") if name and keys else ():
                here = here.setdefault(part, {})
            here.update({key: value for key, value in keys.items() if key[0] != "#"})
        return found

    @property
    def text(self) -> str:
        """The file."""
        blocks = []
        for name, keys in self.tables.items():
            lines = [*self.remarks.get(name, ())] + [f"[{name}]"] * bool(name and keys)
            for key, value in keys.items():
                note = printable(self.notes.get((name, key), ""), LONGEST)
                plain = (
                    key
                    if re.fullmatch(r"(# )?[\w-]+", key, re.ASCII)
                    else json.dumps(key)
                )
                lines.append(f"{plain} = {in_toml(value)}" + f"  # {note}" * bool(note))
            blocks.append("\n".join(lines))
        return "\n\n".join(blocks) + "\n"

    def line(self, key: str) -> int:
        """Number of the line in `text` of a key, of its table if it is not there, else 1.

        Args:
            key: Dotted, with its table's name.
        """
        table, _, name = key.rpartition(".")
        lines = self.text.splitlines()
        heads = (f"[{table}]", f"# [{table}]")
        first = next((k for k, line in enumerate(lines) if line.startswith(heads)), 0)
        keys = [
            k
            for k, line in enumerate(lines)
            if k >= first and line.startswith(f"{name} = ")
        ]
        return 1 + (keys or [first])[0]


def in_toml(value: Any) -> str:
    """A value as TOML writes it.

    Args:
        value: Number, text, or a list or table of these.
    """
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {in_toml(each)}' for key, each in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(in_toml, value))}]"
    return (
        f"{value:.15g}"
        if isinstance(value, float)
        else json.dumps(value, ensure_ascii=True)
    )


Line: TypeAlias = tuple[str, str, Any]
"""A table of a mapping, a key of it, and its value."""


def in_mapping(lines: Iterable[Line]) -> str:
    """Advice to write lines into a mapping; of those about one key the last.

    Args:
        lines: To be applied together, in this order.
    """
    last = {(table, key): value for table, key, value in lines}
    return "in the mapping: " + "; ".join(
        f"[{table}] {key} = {in_toml(value)}".removeprefix("[] ")
        for (table, key), value in last.items()
    )


JITTER = 0.1
"""Of sampling times, relative, from which stamps are doubted."""

HELD = 0.05
"""Part of samples that do not change from which the device is taken to be slower."""


@dataclass(frozen=True)
class SignalReport:
    """How a signal came onto the grid.

    Attributes:
        source: Of which source.
        held: Part of the samples in which no channel changed.
        dropped: Samples left out as held.
        low_pass: Whether it was low-passed, the source being faster than the grid.
        diagnostics: What else a person should know.
    """

    source: str
    held: float
    dropped: int
    low_pass: bool
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True)
class ImportReport:
    """What an import found.

    Attributes:
        rate: Of the recording [Hz].
        samples: Its samples.
        clocks: By source.
        signals: By signal.
    """

    rate: float
    samples: int
    clocks: Mapping[str, ClockReport]
    signals: Mapping[str, SignalReport]

    @staticmethod
    def from_dict(said: Mapping[str, Any]) -> ImportReport:
        """Report that a recording keeps under the fact "import"."""
        return decode(ImportReport, said, {})  # type: ignore[no-any-return]

    def lines(self) -> list[str]:
        """All of it for a person, a line each."""
        return [
            f"{plural(self.samples, 'sample')} at {self.rate:g} Hz "
            f"({(self.samples - 1) / self.rate:.4g} s)",
            *(_clock(name, clock) for name, clock in self.clocks.items()),
        ]

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What to doubt."""
        return (*self._of_clocks(), *self._of_signals())

    def _of_clocks(self) -> Iterator[Diagnostic]:
        for name, clock in self.clocks.items():
            if clock.cut:
                yield diagnose("import.incomplete", name, clock.samples)
            if clock.jitter > JITTER:
                advice = (
                    f"say `steady = true` in [sources.{name}] if the device samples at a constant "
                    "rate"
                )
                missing = "look for lost samples: no constant rate makes these stamps"
                yield diagnose(
                    "import.jitter",
                    name,
                    clock.jitter,
                    advice=advice if clock.even else missing,
                )
            if clock.gaps:
                gaps = (
                    f"{plural(clock.gaps, 'gap')} ({plural(clock.missing, 'sample')})"
                )
                yield diagnose("import.gaps", name, clock.longest_gap, gaps=gaps)

    def _of_signals(self) -> Iterator[Diagnostic]:
        for name, signal in self.signals.items():
            if signal.held > HELD and not signal.dropped and name != "temperature":
                yield diagnose("import.held", name, signal.held, source=signal.source)
            yield from signal.diagnostics


def _clock(name: str, clock: ClockReport) -> str:
    gaps = (
        f"{plural(clock.gaps, 'gap')}, the longest {clock.longest_gap:.3g} s"
        if clock.gaps
        else "no gaps"
    )
    return (
        f"source '{name}': {plural(clock.samples, 'sample')} at {clock.rate:.6g} Hz, jitter "
        f"{clock.jitter:.2%}, {gaps}, {clock.repeated} repeated"
    )
