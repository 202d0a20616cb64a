"""A designed motion: what it promises, how it moves, what it leaves of its limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import plural
from testbed.motion.clearance import FAR
from testbed.motion.excite import Excitation
from testbed.motion.proof import Margin, Proof, slack
from testbed.view.figures import Panel, named_panels
from testbed.view.output import print_tables, write_page
from testbed.view.section import Section, Table

INSTANTS = 400
"""Of a period that are drawn."""

SHOWN = 6
"""Joints that are not folded away."""

MARGINS = 12
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
    print_tables(console, [sigma_table(found, rows)])
    if len(rows) < count:
        console.print(
            f"({count - len(rows)} more with smaller standard deviation: --all)"
        )
    motion, design = found.design.motion, found.design
    count = design.searches
    searched = "one search" if count == 1 else f"the best of {count} searches"
    console.print(
        f"{plural(motion.harmonics, 'harmonic')} of {motion.fundamental:g} Hz, {searched}"
        + ("" if design.complete else " (stopped before they ended)")
    )
    console.print(_promise(found))
    print_proof(console, design.proof, everything=everything)
    console.print(f"written to {out}")


def _promise(found: Excitation) -> str:
    return (
        f"predicted: rms relative standard deviation {found.predicted.rms:.2%}, "
        f"{found.beside_random}; "
        f"condition number {found.predicted.condition:.3g}"
    )


def sigma_table(found: Excitation, rows: Sequence[int]) -> Table:
    """What a motion promises of parameters, and what a random one would.

    Args:
        found: The motion.
        rows: Places of the parameters.
    """
    predicted = found.predicted
    columns = {
        "parameter": [predicted.names[k] for k in rows],
        "predicted\nstd": [f"{predicted.sigma[k]:.2g}" for k in rows],
        "relative\nstd": [f"{predicted.relative[k]:.3%}" for k in rows],
    }
    if found.random is not None:
        random = found.random.relative[list(rows)]
        columns["random\nmotion"] = [
            f"{share:.3%}" if np.isfinite(share) else "-" for share in random
        ]
    return Table.of(columns)


def margin_table(margins: Iterable[Margin]) -> Table:
    """What a motion leaves of its limits, the nearest first.

    Args:
        margins: Of the limits.
    """
    nearest = sorted(margins, key=lambda margin: (margin.holds, margin.left))
    rows = [[m.label, _left(m), f"{m.instant:.3f}"] for m in nearest]
    return Table(["limit on", "margin", "at t [s]"], rows)


def print_proof(console: Console, proof: Proof, *, everything: bool = False) -> None:
    """What a motion leaves of its limits.

    Args:
        console: Where to.
        proof: The proof.
        everything: Whether all limits are printed.
    """
    table, count = margin_table(proof.margins), len(proof.margins)
    shown = count if everything else min(MARGINS, count)
    print_tables(console, [Table(table.heads, table.rows[:shown])])
    if shown < count:
        console.print(f"({count - shown} more limits with larger margins: --all)")
    if not proof.holds:
        failed = sum(not margin.holds for margin in proof.margins)
        console.print(
            f"NOT proven: {failed} of {plural(count, 'limit')}; {proof.worst.words}"
        )
        return
    held = len(proof.binding)
    console.print(
        f"verified at every instant: {plural(count, 'limit')}"
        + (f"; {held} nearly reached" if held else "")
        + (
            ""
            if any(each.unit for each in proof.margins)
            else "; collisions not checked"
        )
    )


def _left(margin: Margin) -> str:
    return f"{margin.left * 1000:.1f} mm" if margin.unit else f"{margin.left:.2%}"


def write_motion_page(path: Path, found: Excitation) -> None:
    """Write the page of a motion.

    Args:
        path: The HTML file; what stands there is replaced.
        found: The motion.
    """
    write_page(path, "motion.html", motion_contents(found))


def motion_contents(found: Excitation) -> dict[str, Any]:
    """All that the page shows."""
    motion, proof = found.design.motion, found.design.proof
    return {
        "title": f"Motion of {found.tree.name}",
        "summary": [
            f"{plural(motion.harmonics, 'harmonic')} of {motion.fundamental:g} Hz; "
            f"predicted rms of relative standard deviations {found.predicted.rms:.2%}, "
            f"{found.beside_random}.",
            *(f"Warning: {line}." for line in sentences(found.diagnostics)),
        ],
        "holds": proof.holds,
        "verdict": f"all {plural(len(proof.margins), 'limit')} proven at every moment"
        if proof.holds
        else f"not proven: {proof.worst.words}",
        "figures": [_sigma_figure(found), _motion_figure(found), _limit_figure(found)],
    }


def _sigma_figure(found: Excitation) -> Section:
    names, promised = found.predicted.names, found.predicted.relative
    random = None if found.gain is None else found.random
    values = {} if random is None else {"measured": 100 * random.relative}
    values["external"] = 100 * promised
    return Section(
        id="sigma",
        title="Predicted standard deviations",
        says=(
            "Standard deviation of each parameter for white noise of this instrument, predicted "
            "for this motion and for the best random one."
        ),
        legend={"measured": "random motion", "external": "this motion"}
        if random is not None
        else {"external": "this motion"},
        panels=named_panels(
            "", names, values, "relative standard deviation [%]", log=True
        ),
        caption=(
            f"For {found.problem.pipeline.span:.4g} s of a recording, without filter transients. "
            "Logarithmic scale."
        ),
        table=sigma_table(found, range(len(names))),
    )


def _times(found: Excitation) -> Array:
    return np.linspace(0, found.design.motion.period, INSTANTS)


def _motion_figure(found: Excitation) -> Section:
    times, motion, limits = _times(found), found.design.motion, found.rules.limits
    panels, rows = [], []
    for j, joint in enumerate(found.tree.joints):
        q, qd, qdd = (motion.derivative(times, order)[:, j] for order in range(3))
        unit = "rad" if joint.revolute else "m"
        below = {
            f"velocity [{unit}/s]": {"external": (times, qd)},
            f"acceleration [{unit}/s²]": {"external": (times, qdd)},
        }
        title = f"{joint.name}: position [{unit}]"
        panels.append(Panel(title, {"external": (times, q)}, "time [s]", below=below))
        rows.append(
            [
                joint.name,
                f"{q.min():.3g} to {q.max():.3g}",
                f"{limits.low[j]:.3g} to {limits.high[j]:.3g}",
                f"{np.abs(qd).max():.3g} of {limits.velocity[j]:.3g}",
                f"{np.abs(qdd).max():.3g} of {limits.acceleration[j]:.3g}",
            ]
        )
    return Section(
        id="motion",
        title="Motion",
        says="One period, joint by joint; it repeats as often as the recording lasts.",
        panels=panels,
        shown=SHOWN,
        table=Table(
            [
                "joint",
                "position",
                "allowed",
                "largest velocity",
                "largest acceleration",
            ],
            rows,
        ),
    )


def _limit_figure(found: Excitation) -> Section:
    times = _times(found)
    panels = [
        Panel(
            f"margin to {kind.label} [{kind.unit}]",
            {"external": (times, kind.left)},
            "time [s]",
            from_zero=bool((kind.left >= 0).all()),
        )
        for kind in slack(found.design.motion, found.rules, times)
    ]
    return Section(
        id="limits",
        title="Margins to limits",
        says=(
            "Smallest margin to the limits of each kind over time. The table lists margins that "
            "are proven for every instant, between the samples too."
        ),
        panels=panels,
        caption=_allowed(found),
        table=margin_table(found.design.proof.margins),
    )


def _allowed(found: Excitation) -> str:
    rules = found.rules
    said = f"{rules.margin:.0%} of each limit may be used."
    if rules.collision is not None and rules.collision.pairs:
        least = 1000 * float(rules.clearance.max())
        said += (
            f" Distances are between bodies not connected by a joint. The margin is what exceeds "
            f"the required {least:g} mm; it is drawn up to {1000 * FAR:g} mm."
        )
        if rules.clearance.min() < rules.clearance.max():
            said += " Pairs that keep less are not drawn; the table has them."
    lines = (f"{line[:1].upper()}{line[1:]}." for line in sentences(rules.diagnostics))
    return " ".join([said, *lines])
