"""A designed motion and its proof on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from testbed.errors import plural

if TYPE_CHECKING:
    from rich.console import Console

    from testbed.excitation.proof import Margin, Proof
    from testbed.experiment.excite import Excitation

SHOWN = 12
"""Margins printed, the smallest first."""

ROWS = 10
"""Parameters printed where not all are asked for, the least known first."""


def print_excitation(
    console: Console, found: Excitation, out: Path, *, everything: bool = False
) -> None:
    """What was designed, what it promises, what it leaves of the limits.

    Args:
        console: Where to.
        found: The design.
        out: Where the motion was written.
        everything: Whether all parameters and limits are printed.
    """
    count = len(found.predicted.names)
    least_known = np.argsort(-found.predicted.relative, kind="stable")
    rows = range(count) if everything else least_known[:ROWS].tolist()
    console.print(_sigma_table(found, rows))
    if len(rows) < count:
        console.print(f"({count - len(rows)} more that are better known: --all)")
    motion, design = found.design.motion, found.design
    count = len(design.searches)
    searched = "one search" if count == 1 else f"the best of {count} searches"
    console.print(
        f"{plural(motion.harmonics, 'harmonic')} of {motion.fundamental:g} Hz, {searched}"
        + ("" if design.complete else " (stopped before they ended)")
    )
    console.print(_promise(found))
    print_proof(console, design.proof, everything=everything)
    console.print(f"written to {out}", soft_wrap=True)


def _promise(found: Excitation) -> str:
    return (
        f"predicted: rms relative sigma {found.predicted.rms:.3g}, {found.beside_random}; "
        f"condition number {found.predicted.condition:.3g}"
    )


def _sigma_table(found: Excitation, rows: Sequence[int]) -> Table:
    table = Table(box=SIMPLE_HEAD, header_style="bold")
    table.add_column("parameter", no_wrap=True)
    table.add_column("predicted\nsigma", justify="right", no_wrap=True)
    table.add_column("of its\nvalue", justify="right", no_wrap=True)
    if found.random_predicted is not None:
        table.add_column("random\nmotion", justify="right", no_wrap=True)
    for k in rows:
        name, relative = found.predicted.names[k], found.predicted.relative[k]
        row = [name, f"{found.predicted.sigma[k]:.2g}", f"{relative:.2%}"]
        if found.random_predicted is not None:
            random = found.random_predicted.relative[k]
            row.append(f"{random:.2%}" if np.isfinite(random) else "-")
        table.add_row(*row)
    return table


def print_proof(console: Console, proof: Proof, *, everything: bool = False) -> None:
    """What a motion leaves of its limits.

    Args:
        console: Where to.
        proof: The proof.
        everything: Whether all limits are printed.
    """
    nearest = sorted(proof.margins, key=lambda margin: (margin.holds, margin.left))
    table = Table(box=SIMPLE_HEAD, header_style="bold")
    table.add_column("limit on")
    table.add_column("left", justify="right", no_wrap=True)
    table.add_column("at t [s]", justify="right", no_wrap=True)
    shown = nearest if everything else nearest[:SHOWN]
    for margin in shown:
        table.add_row(margin.label, _left(margin), f"{margin.instant:.3f}")
    console.print(table)
    if len(shown) < len(nearest):
        console.print(f"({len(nearest) - len(shown)} more limits with more left: --all)")
    if not proof.holds:
        failed = sum(not margin.holds for margin in proof.margins)
        console.print(
            f"NOT proven: {failed} of {plural(len(proof.margins), 'limit')}; {proof.worst.words}"
        )
        return
    held = proof.binding
    console.print(
        f"proven at every moment: {plural(len(proof.margins), 'limit')}"
        + (f"; it comes up to {len(held)} of them" if held else "")
    )


def _left(margin: Margin) -> str:
    return f"{margin.left * 1000:.1f} mm" if margin.unit else f"{margin.left:.2%}"
