"""What an estimate says of the instrument: numbers of the plate, and traces of faults."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import phrase
from testbed.experiment.run import SAID, Run, matrix_errors
from testbed.identification.calibration import Calibration
from testbed.identification.estimate import Estimate
from testbed.identification.estimate_text import number_with_sigma
from testbed.identification.sensor.estimates import TraceTest
from testbed.recordings.columns import AXES
from testbed.reporting.section import DARKEST, HeatTable, Table

LARGEST = 3
"""Numbers of a fault that are shown."""

CLEAR = 1e-3
"""Chance above which sizes mean nothing and are left out."""


@dataclass(frozen=True)
class TraceTable(Table):
    """A table of faults.

    Attributes:
        traced: Whether it holds what is no chance.
    """

    traced: bool = True


def instrument_tables(run: Run) -> list[TraceTable]:
    """Numbers of the instrument and faults looked for; none without the plate's estimate.

    Args:
        run: The run.
    """
    return [table for estimate in run.estimates.values() for table in _of_estimate(estimate)]


def _of_estimate(estimate: Estimate) -> Iterator[TraceTable]:
    if estimate.nuisances:
        rows = [[n.name, n.unit, f"{n.value:.4g}", f"{n.sigma:.2g}"] for n in estimate.nuisances]
        yield TraceTable(["what", "unit", "value", "sigma"], rows, "Estimated with the parameters")
    tested = sorted(estimate.trace_tests, key=lambda test: test.chance)
    clear = [_test(test) for test in tested if test.chance <= CLEAR]
    others = [[phrase(t.nuisance.kind), _chance(t.chance)] for t in tested[len(clear) :]]
    if clear:
        heads = ["fault", "chance", "would move", "size"]
        yield TraceTable(heads, clear, "Faults that left a trace, the clearest first")
    if others:
        title = "Faults without a clear trace"
        yield TraceTable(["fault", "chance"], others, title, traced=False)
    found = None if estimate.noise is None else estimate.noise.repetition
    if found is not None:
        shares = zip(estimate.channels, found.share, strict=True)
        yield TraceTable(
            ["channel", "part"],
            [[channel, f"{max(0.0, share):.0%}"] for channel, share in shares],
            f"Part of the residuals that repeats with the motion, every {found.period:.4g} s: "
            f"chance {_chance(found.chance)} in mere noise",
            traced=found.chance <= CLEAR,
        )


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


def matrix_maps(run: Run) -> list[HeatTable]:
    """The plate's matrix before and after calibration: its errors, and sigma of each; [] for none.

    Args:
        run: The run.
    """
    found = matrix_errors(run)
    if found is None:
        return []
    scale = DARKEST / found.most if found.most else 0.0

    def table(caption: str, values: Array) -> HeatTable:
        rows = [
            (name, [{"text": f"{v:.2g}", "share": round(scale * abs(v))} for v in line])
            for name, line in zip(AXES, values.tolist(), strict=True)
        ]
        return HeatTable(caption, AXES, rows)

    return [
        table(f"Before: error of the matrix, {SAID}", found.error),
        table(f"After: what its sigma leaves, {SAID}", found.sigma),
    ]


def plate_table(plate: Calibration) -> Table:
    """The matrix of a plate.

    Args:
        plate: The calibration.
    """
    values, sigmas = plate.matrix.tolist(), plate.matrix_sigma.tolist()
    rows = [
        [name, *(_cell(v, s) for v, s in zip(values[k], sigmas[k], strict=True))]
        for k, name in enumerate(AXES)
    ]
    title = "what a channel (row) shows of a component of the wrench (column)"
    return Table(["", *AXES], rows, title, parts=(range(1, 4), range(4, 7)))


def _cell(value: float, sigma: float) -> str:
    return number_with_sigma(value, sigma, short=True) if sigma else f"{value:.6g}"


def plate_lines(plate: Calibration) -> list[str]:
    """The other numbers, a line each kind.

    Args:
        plate: The calibration.
    """
    kinds: dict[str, list[str]] = {}
    for each in plate.numbers:
        if each.kind != "matrix":
            number = f"{each.name} {number_with_sigma(each.value, each.sigma)} {each.unit}"
            kinds.setdefault(each.kind, []).append(number.rstrip())
    return [", ".join(numbers) for numbers in kinds.values()]
