"""Tables of instruments.md, from faults and effects themselves: `python -m docs.instruments`."""

from __future__ import annotations

from pathlib import Path

from docs.marks import write
from testbed.lab.simulation.effects import EFFECT_KINDS as EFFECTS
from testbed.sensors.catalogue import simulated_errors
from testbed.sensors.kinds_in_words import describe_kind, kind_table_lines
from testbed.sensors.sensor_error import StageOrder

DOCUMENT = Path(__file__).with_suffix(".md")
MODULE = "docs.instruments"
TITLES = {"position": "Encoders", "torque": "Drives", "wrench": "The plate", "tare": "The tare"}


def as_markdown(of: str) -> str:
    """The tables of all faults, or of all effects.

    Args:
        of: Which of both.
    """
    if of == "faults":
        return catalogue()
    return "\n".join(
        ["", *kind_table_lines([describe_kind(effect) for effect in EFFECTS.values()]), "", ""]
    )


def catalogue() -> str:
    """Tables of all faults: their stages, then one a signal."""
    kinds = tuple(simulated_errors().values())
    lines = ["", "| stage | " + " | ".join(TITLES.values()) + " |"]
    lines += ["| --- " * (1 + len(TITLES)) + "|"]
    for stage in StageOrder:
        here = [fault for fault in kinds if fault.stage == stage]
        cells = [", ".join(f"`{f.kind}`" for f in here if f.signal == s) for s in TITLES]
        lines.append(f"| {stage.name.lower()} | {' | '.join(cells)} |")
    for signal, title in TITLES.items():
        own = [describe_kind(fault) for fault in kinds if fault.signal == signal]
        lines += ["", f"### {title}", "", *kind_table_lines(own)]
    lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown)
