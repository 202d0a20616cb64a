"""Report of an import, with diagnostics of clocks and samples; drafts of mapping files."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from testbed.core.base.codec import from_json_values
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import count_with_noun, printable_line
from testbed.importing.source_clock import ClockReport

MAX_NOTE_LENGTH = 300
"""Largest number of characters of a note."""


@dataclass(frozen=True)
class MappingDraft:
    """Draft of a mapping file: tables, comments on keys, and comment lines above tables.

    Attributes:
        tables: Keys and values, keyed by the dotted name of their table; the top level has an empty
            name.
        key_comments: Comment at the end of a key's line, keyed by table and key.
        table_comments: Comment lines above a table, or in place of a missing table.
    """

    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    key_comments: Mapping[tuple[str, str], str] = field(default_factory=dict)
    table_comments: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def with_key(
        self, table: str, key: str, value: Any, note: str = ""
    ) -> MappingDraft:
        """Draft with a new value and comment for a key.

        Args:
            table: Dotted name of the table.
            key: Key in the table.
            value: Number, text, list or table; None removes the key.
            note: Comment at the end of the key's line; empty for no comment.
        """
        entries = {**self.tables.get(table, {}), key: value}
        keys = {name: each for name, each in entries.items() if each is not None}
        notes = {
            location: each
            for location, each in self.key_comments.items()
            if location != (table, key)
        }
        notes |= {(table, key): note} if note and value is not None else {}
        return replace(self, tables={**self.tables, table: keys}, key_comments=notes)

    def with_keys(
        self, table: str, keys: Iterable[tuple[str, Any, str]]
    ) -> MappingDraft:
        """Draft with new values and comments for several keys of a table.

        Args:
            table: Dotted name of the table.
            keys: Keys with values and comments.
        """
        draft = self
        for key, value, note in keys:
            draft = draft.with_key(table, key, value, note)
        return draft

    def with_comment_lines(self, table: str, *lines: str) -> MappingDraft:
        """Draft with additional comment lines above a table, or in place of a missing table.

        Args:
            table: Dotted name of the table.
            lines: Comment lines, starting with "#".
        """
        comments = [*self.table_comments.get(table, ()), *lines]
        return replace(
            self,
            tables={**self.tables, table: self.tables.get(table, {})},
            table_comments={**self.table_comments, table: comments},
        )

    @property
    def content(self) -> dict[str, Any]:
        """Content of the draft as parsed TOML, without keys that begin with #."""
        root: dict[str, Any] = {}
        for name, keys in self.tables.items():
            table = root
            for part in name.split(".") if name and keys else ():
                table = table.setdefault(part, {})
            table.update({key: value for key, value in keys.items() if key[0] != "#"})
        return root

    @property
    def text(self) -> str:
        """Content of the draft as TOML text."""
        blocks = []
        for name, keys in self.tables.items():
            lines = [*self.table_comments.get(name, ())] + [f"[{name}]"] * bool(
                name and keys
            )
            for key, value in keys.items():
                note = printable_line(
                    self.key_comments.get((name, key), ""), MAX_NOTE_LENGTH
                )
                key_text = (
                    key
                    if re.fullmatch(r"(# )?[\w-]+", key, re.ASCII)
                    else json.dumps(key)
                )
                lines.append(
                    f"{key_text} = {toml_value(value)}" + f"  # {note}" * bool(note)
                )
            blocks.append("\n".join(lines))
        return "\n\n".join(blocks) + "\n"

    def line_number(self, key: str) -> int:
        """Line number of a key in `text`, or of the key's table.

        The line number is that of the table if the key is missing, and 1 if the table is missing
        too.

        Args:
            key: Key with the dotted name of its table.
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


def toml_value(value: Any) -> str:
    """Value in TOML notation.

    Args:
        value: Number, text, or a list or table of these.
    """
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {toml_value(each)}' for key, each in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return (
        f"{value:.15g}"
        if isinstance(value, float)
        else json.dumps(value, ensure_ascii=True)
    )


MappingLine: TypeAlias = tuple[str, str, Any]
"""Table of a mapping file, key in it, and value."""


def mapping_advice(lines: Iterable[MappingLine]) -> str:
    """Advice to write lines into the mapping file; the last line per key takes precedence.

    Args:
        lines: Lines to be applied together, in this order.
    """
    last = {(table, key): value for table, key, value in lines}
    return "in the mapping: " + "; ".join(
        f"[{table}] {key} = {toml_value(value)}".removeprefix("[] ")
        for (table, key), value in last.items()
    )


MAX_JITTER = 0.1
"""Standard deviation of sampling intervals, relative, from which time stamps are reported."""

MAX_HELD_SHARE = 0.05
"""Share of unchanged samples from which the device is taken to be slower than the recording."""


@dataclass(frozen=True)
class SignalReport:
    """Report on the samples of a signal.

    Attributes:
        source: Name of the source.
        held: Share of samples in which no channel changed.
        dropped: Number of samples omitted because they are unchanged.
        low_pass: True if the signal was low-pass filtered because the source is faster than the
            grid.
        diagnostics: Diagnostics of the signal.
    """

    source: str
    held: float
    dropped: int
    low_pass: bool
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True)
class ImportReport:
    """Report of an import.

    Attributes:
        rate: Rate of the recording [Hz].
        samples: Number of samples of the recording.
        clocks: Reports on time stamps, keyed by source.
        signals: Reports on samples, keyed by signal.
    """

    rate: float
    samples: int
    clocks: Mapping[str, ClockReport]
    signals: Mapping[str, SignalReport]

    @staticmethod
    def from_dict(content: Mapping[str, Any]) -> ImportReport:
        """Report from the entry "import" in a recording's metadata.

        Args:
            content: Value of the entry.
        """
        return from_json_values(ImportReport, content, {})  # type: ignore[no-any-return]

    def text_lines(self) -> list[str]:
        """Lines of text: duration and rate of the recording, then the clock of each source."""
        return [
            f"{count_with_noun(self.samples, 'sample')} at {self.rate:g} Hz "
            f"({(self.samples - 1) / self.rate:.4g} s)",
            *(_clock_line(name, clock) for name, clock in self.clocks.items()),
        ]

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of clocks and signals."""
        return (*self._clock_diagnostics(), *self._signal_diagnostics())

    def _clock_diagnostics(self) -> Iterator[Diagnostic]:
        """Yield diagnostics of incomplete last samples, jitter above 0.1, and gaps, per source."""
        for name, clock in self.clocks.items():
            if clock.cut:
                yield make_diagnostic("import.incomplete", name, clock.samples)
            if clock.jitter > MAX_JITTER:
                steady_advice = (
                    f"say `steady = true` in [sources.{name}] if the device samples at a constant "
                    "rate"
                )
                lost_advice = (
                    "look for lost samples: no constant rate makes these stamps"
                )
                yield make_diagnostic(
                    "import.jitter",
                    name,
                    clock.jitter,
                    advice=steady_advice if clock.even else lost_advice,
                )
            if clock.gaps:
                gaps = (
                    f"{count_with_noun(clock.gaps, 'gap')} "
                    f"({count_with_noun(clock.missing, 'sample')})"
                )
                yield make_diagnostic("import.gaps", name, clock.longest_gap, gaps=gaps)

    def _signal_diagnostics(self) -> Iterator[Diagnostic]:
        """Yield diagnostics of repeated samples, and the report's own diagnostics, for each signal.

        Repeated samples are reported if their share exceeds 0.05 and no samples were omitted;
        temperatures are exempt.
        """
        for name, signal in self.signals.items():
            if (
                signal.held > MAX_HELD_SHARE
                and not signal.dropped
                and name != "temperature"
            ):
                yield make_diagnostic(
                    "import.held", name, signal.held, source=signal.source
                )
            yield from signal.diagnostics


def _clock_line(name: str, clock: ClockReport) -> str:
    """Line of text about the clock of a source: samples, rate, jitter and gaps."""
    gaps = (
        f"{count_with_noun(clock.gaps, 'gap')}, the longest {clock.longest_gap:.3g} s"
        if clock.gaps
        else "no gaps"
    )
    return (
        f"source '{name}': {count_with_noun(clock.samples, 'sample')} at {clock.rate:.6g} Hz, "
        f"jitter {clock.jitter:.2%}, {gaps}, {clock.repeated} repeated"
    )
