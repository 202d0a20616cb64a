"""What an estimate says of the instrument: its numbers, and tests for traces of its faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.diagnostics.diagnostic import phrase
from testbed.experiment.run import Run
from testbed.identification.noise.repetition import Repetition
from testbed.identification.nuisances.estimates import TraceTest

LARGEST = 3
"""Numbers of a fault that are shown."""

CLEAR = 1e-3
"""Chance above which sizes mean nothing and are left out."""


def instrument_tables(run: Run) -> list[dict[str, Any]]:
    """Tables, each with its caption, heads and rows of words; none without the plate's estimate.

    Those are traced that hold what is no chance.

    Args:
        run: The run.
    """
    tables: list[dict[str, Any]] = []
    for estimate in run.estimates.values():
        if estimate.nuisances:
            tables.append(
                {
                    "caption": "Estimated with the parameters",
                    "traced": True,
                    "heads": ["what", "unit", "value", "sigma"],
                    "rows": [
                        [n.name, n.unit, f"{n.value:.4g}", f"{n.sigma:.2g}"]
                        for n in estimate.nuisances
                    ],
                }
            )
        if estimate.trace_tests:
            tested = sorted(estimate.trace_tests, key=lambda test: test.chance)
            clear = [test for test in tested if test.chance <= CLEAR]
            others = tested[len(clear) :]
            if clear:
                tables.append(
                    {
                        "caption": "Faults that left a trace, the clearest first",
                        "traced": True,
                        "heads": ["fault", "chance", "would move", "size"],
                        "rows": [_test(test) for test in clear],
                    }
                )
            if others:
                tables.append(
                    {
                        "caption": "Faults without a clear trace",
                        "traced": False,
                        "heads": ["fault", "chance"],
                        "rows": [[phrase(t.nuisance.kind), _chance(t.chance)] for t in others],
                    }
                )
        if estimate.noise is not None and estimate.noise.repetition is not None:
            tables.append(_repetition(estimate.noise.repetition, estimate.channels))
    return tables


def _repetition(found: Repetition, channels: Sequence[str]) -> dict[str, Any]:
    return {
        "caption": f"Part of the residuals that repeats with the motion, every {found.period:.4g} "
        f"s: chance {_chance(found.chance)} in mere noise",
        "traced": found.chance <= CLEAR,
        "heads": ["channel", "part"],
        "rows": [
            [channel, f"{max(0.0, share):.0%}"]
            for channel, share in zip(channels, found.share, strict=True)
        ],
    }


def _chance(chance: float) -> str:
    return "below 1e-99" if chance < 1e-99 else f"{chance:.2g}"


def _test(test: TraceTest) -> list[str]:
    shift = f"{test.parameter} by {test.shift:.2g} sigma"
    return [
        phrase(test.nuisance.kind),
        _chance(test.chance),
        shift,
        "; ".join(test.largest(LARGEST)),
    ]
