"""Model errors beside the parameters, a panel a family: `python -m docs.pictures.model_errors`.

A plausible size of each, beside the parameters, in the channel that shows it most.
"""

from __future__ import annotations

from textwrap import shorten

import numpy as np

import testbed as tb
from docs.pictures.drawing import line, save, words
from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.catalogue import model_error_families
from testbed.core.estimation.model_errors.error_rows import error_rows
from testbed.core.estimation.problem import Problem
from tests.helpers.measured import measured
from tests.helpers.runs import robot

WIDE, HIGH, COLUMNS = 225, 92, 3
"""Of a panel [pixels], and how many lie side by side."""

SMALL = "font-size: 12px"


def main() -> None:
    """One panel a family."""
    tree = robot("ur5")
    recording = measured(tree, 4, duration=20.0, noise=0.1)
    shown: dict[str, tuple[str, str, Array]] = {}
    for method in ("torque", "wrench"):
        estimate = tb.identify(tree, recording, method)
        problem = Problem.from_recording(tree, recording, method)
        none = np.zeros((0, len(estimate.values) + 1))
        rows = error_rows(problem, problem.source, estimate.values, none)
        families = [f for f in model_error_families() if f.physical and method in f.methods]
        unknowns = rows.whitened_rows(rows.columns)
        for family in families:
            columns = rows.family_columns([family])[0][family.kind]
            some = np.random.default_rng(1).normal(size=columns.shape[2])
            signal = columns @ (some / np.sqrt(columns.shape[2]))
            flat = unknowns.reshape(-1, unknowns.shape[2])
            signal -= (flat @ np.linalg.lstsq(flat, signal.ravel(), 1e-9)[0]).reshape(signal.shape)
            most = int(np.argmax((signal**2).sum(axis=1)))
            unit = estimate.channel_units[most]
            label = f"{estimate.channels[most]} [{unit}]"
            shown.setdefault(family.kind, (family.label, label, signal[most]))
    parts = []
    for k, (label, channel, values) in enumerate(shown.values()):
        left, top = 12 + WIDE * (k % COLUMNS), 10 + HIGH * (k // COLUMNS)
        most = float(np.abs(values).max())
        parts.append(words(left, top + 12, shorten(label, 35, placeholder=" ..."), style=SMALL))
        parts.append(words(left, top + 27, f"{channel}, +-{most:.2g}", style=SMALL, colour="faint"))
        parts.append(line((left, top + 56, left + WIDE - 25, top + 56), "faint", 0.5))
        x = left + (WIDE - 25) * np.arange(len(values)) / len(values)
        y = top + 56 - 24 * values / most
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="var(--wrench)" stroke-width="1.3"/>'
        )
    height = 20 + HIGH * -(-len(shown) // COLUMNS)
    label = "Residuals of a UR5 in 20 s by each family of model errors, beside the parameters"
    save("model_errors", 24 + WIDE * COLUMNS, height, parts, label)


if __name__ == "__main__":
    main()
