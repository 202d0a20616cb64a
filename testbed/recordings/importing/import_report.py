"""What an import found: every source's clock, every signal's samples, and what to doubt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from testbed.diagnostics.diagnostic import Diagnostic, diagnose, from_json
from testbed.errors import plural
from testbed.recordings.importing.source_clock import ClockReport

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
        use: What the signal was held against, and what it is for; empty where that is plain.
    """

    source: str
    held: float
    dropped: int
    low_pass: bool
    diagnostics: tuple[Diagnostic, ...] = ()
    use: str = ""


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

    def as_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        found = asdict(self)
        for signal in found["signals"].values():
            signal["diagnostics"] = list(signal["diagnostics"])
        return found

    @staticmethod
    def from_dict(said: Mapping[str, Any]) -> ImportReport:
        """Of `as_dict`, as a recording keeps it under the fact "import"."""
        clocks = {name: ClockReport(**each) for name, each in said["clocks"].items()}
        signals = {}
        for name, each in said["signals"].items():
            own = {key: value for key, value in each.items() if key != "notes"}  # texts, once
            own["diagnostics"] = from_json(each.get("diagnostics", each.get("notes", ())))
            signals[name] = SignalReport(**own)
        return ImportReport(said["rate"], said["samples"], clocks, signals)

    def lines(self) -> list[str]:
        """All of it for a person, a line each."""
        return [
            f"{plural(self.samples, 'sample')} at {self.rate:g} Hz "
            f"({(self.samples - 1) / self.rate:.4g} s)",
            *(_clock(name, clock) for name, clock in self.clocks.items()),
            *(_signal(name, signal) for name, signal in self.signals.items()),
        ]

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What to doubt."""
        return (*self._of_clocks(), *self._of_signals())

    def _of_clocks(self) -> Iterator[Diagnostic]:
        for name, clock in self.clocks.items():
            if clock.cut:
                yield diagnose("import.incomplete", name)
            if clock.jitter > JITTER:
                yield diagnose("import.jitter", name, clock.jitter)
            if clock.gaps:
                gaps = plural(clock.gaps, "gap")
                yield diagnose("import.gaps", name, clock.longest_gap, gaps=gaps)

    def _of_signals(self) -> Iterator[Diagnostic]:
        for name, signal in self.signals.items():
            if signal.held > HELD and not signal.dropped:
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


def _signal(name: str, signal: SignalReport) -> str:
    filtered = "low-pass and spline" if signal.low_pass else "spline"
    dropped = f", {signal.dropped} left out" if signal.dropped else ""
    held = f"{signal.held:.1%} repeated values"
    return f"{name} of '{signal.source}': {filtered}, {held}{dropped}{signal.use}"
