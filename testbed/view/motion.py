"""Output of a designed motion: predicted standard deviations, curves, margins to limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import count_with_noun
from testbed.motion.clearance import MAX_DISTANCE
from testbed.motion.excite import Excitation
from testbed.motion.proof import Margin, Proof, slack_by_kind
from testbed.view.figures import Panel, named_panels
from testbed.view.output import print_tables, write_page
from testbed.view.section import Section, Table

INSTANT_COUNT = 400
"""Number of plotted instants of a period."""

VISIBLE_JOINTS = 6
"""Number of joints whose plots are not folded away."""

MAX_MARGINS = 12
"""Largest number of printed margins, smallest first."""

MAX_ROWS = 10
"""Largest number of printed parameters, largest relative standard deviation first."""


def print_excitation(
    console: Console, excitation: Excitation, out: Path, *, everything: bool = False
) -> None:
    """Print a designed motion: predicted standard deviations, harmonics, margins to limits.

    By default, only the `MAX_ROWS` parameters with the largest relative standard deviations are
    printed.

    Args:
        console: Console of the output.
        excitation: The designed motion.
        out: File to which the motion was written.
        everything: True to print all parameters and limits.
    """
    count = len(excitation.predicted.names)
    least_known = np.argsort(-excitation.predicted.relative, kind="stable")
    rows = range(count) if everything else least_known[:MAX_ROWS].tolist()
    print_tables(console, [predicted_sigma_table(excitation, rows)])
    if len(rows) < count:
        console.print(
            f"({count - len(rows)} more with smaller standard deviation: --all)"
        )
    motion, design = excitation.design.motion, excitation.design
    count = design.searches
    search_text = "one search" if count == 1 else f"the best of {count} searches"
    console.print(
        f"{count_with_noun(motion.harmonics, 'harmonic')} of {motion.fundamental:g} Hz, "
        f"{search_text}"
        + ("" if design.is_complete else " (stopped before they ended)")
    )
    console.print(_prediction_sentence(excitation))
    print_limit_margins(console, design.proof, everything=everything)
    console.print(f"written to {out}")


def _prediction_sentence(excitation: Excitation) -> str:
    """Sentence with the predicted rms relative standard deviation and condition number.

    The standard deviation is compared with that of a random motion.
    """
    return (
        f"predicted: rms relative standard deviation {excitation.predicted.rms:.2%}, "
        f"{excitation.beside_random}; "
        f"condition number {excitation.predicted.condition:.3g}"
    )


def predicted_sigma_table(excitation: Excitation, rows: Sequence[int]) -> Table:
    """Table of predicted standard deviations, absolute and relative.

    If a random motion was found, the last column has the relative standard deviations for it.

    Args:
        excitation: The designed motion.
        rows: Indices of the parameters, in the order of the table.
    """
    predicted = excitation.predicted
    columns = {
        "parameter": [predicted.names[k] for k in rows],
        "predicted\nstd": [f"{predicted.sigma[k]:.2g}" for k in rows],
        "relative\nstd": [f"{predicted.relative[k]:.3%}" for k in rows],
    }
    if excitation.random is not None:
        random = excitation.random.relative[list(rows)]
        columns["random\nmotion"] = [
            f"{share:.3%}" if np.isfinite(share) else "-" for share in random
        ]
    return Table.from_columns(columns)


def margin_table(margins: Iterable[Margin]) -> Table:
    """Table of the margins of a motion to its limits.

    Each margin has the instant at which it is smallest [s]. Exceeded limits come first, then the
    others in the order of increasing margin.

    Args:
        margins: Margins to the limits.
    """
    sorted_margins = sorted(
        margins, key=lambda margin: (margin.is_respected, margin.left)
    )
    rows = [
        [margin.label, _margin_text(margin), f"{margin.instant:.3f}"]
        for margin in sorted_margins
    ]
    return Table(["limit on", "margin", "at t [s]"], rows)


def print_limit_margins(
    console: Console, proof: Proof, *, everything: bool = False
) -> None:
    """Print the margins of a motion to its limits, and the result of the proof.

    Args:
        console: Console of the output.
        proof: Margins, and the result of the proof that all limits are respected.
        everything: True to print all limits, False for the `MAX_MARGINS` smallest margins.
    """
    table, count = margin_table(proof.margins), len(proof.margins)
    row_count = count if everything else min(MAX_MARGINS, count)
    print_tables(console, [Table(table.heads, table.rows[:row_count])])
    if row_count < count:
        console.print(f"({count - row_count} more limits with larger margins: --all)")
    if not proof.is_valid:
        failed = sum(not margin.is_respected for margin in proof.margins)
        limits = count_with_noun(count, "limit")
        smallest = proof.smallest_margin.words
        console.print(f"NOT proven: {failed} of {limits}; {smallest}")
        return
    binding_count = len(proof.binding)
    console.print(
        f"verified at every instant: {count_with_noun(count, 'limit')}"
        + (f"; {binding_count} nearly reached" if binding_count else "")
        + (
            ""
            if any(each.unit for each in proof.margins)
            else "; collisions not checked"
        )
    )


def _margin_text(margin: Margin) -> str:
    """Text of a margin: distance in mm, or unused fraction of a limit in percent."""
    return f"{margin.left * 1000:.1f} mm" if margin.unit else f"{margin.left:.2%}"


def write_motion_page(path: Path, excitation: Excitation) -> None:
    """Write the HTML page of a designed motion.

    Args:
        path: The HTML file, replaced if it exists.
        excitation: The designed motion.
    """
    write_page(path, "motion.html", motion_contents(excitation))


def motion_contents(excitation: Excitation) -> dict[str, Any]:
    """Template variables of the motion page: title, summary, verdict and figures.

    Args:
        excitation: The designed motion.
    """
    motion, proof = excitation.design.motion, excitation.design.proof
    return {
        "title": f"Motion of {excitation.tree.name}",
        "summary": [
            f"{count_with_noun(motion.harmonics, 'harmonic')} of {motion.fundamental:g} Hz; "
            f"predicted rms of relative standard deviations {excitation.predicted.rms:.2%}, "
            f"{excitation.beside_random}.",
            *(f"Warning: {line}." for line in sentences(excitation.diagnostics)),
        ],
        "is_valid": proof.is_valid,
        "verdict": f"all {count_with_noun(len(proof.margins), 'limit')} proven at every moment"
        if proof.is_valid
        else f"not proven: {proof.smallest_margin.words}",
        "figures": [
            _sigma_section(excitation),
            _motion_section(excitation),
            _limit_section(excitation),
        ],
    }


def _sigma_section(excitation: Excitation) -> Section:
    """Section with the predicted relative standard deviations of all parameters [%].

    The standard deviations for the best random motion are drawn too, if it identifies all
    parameters.
    """
    names, relative_sigmas = excitation.predicted.names, excitation.predicted.relative
    random = None if excitation.gain is None else excitation.random
    values = {} if random is None else {"measured": 100 * random.relative}
    values["wrench"] = 100 * relative_sigmas
    return Section(
        id="sigma",
        title="Predicted standard deviations",
        explanation=(
            "Standard deviation of each parameter for white noise of this instrument, predicted "
            "for this motion and for the best random one."
        ),
        legend={"measured": "random motion", "wrench": "this motion"}
        if random is not None
        else {"wrench": "this motion"},
        panels=named_panels(
            "", names, values, "relative standard deviation [%]", log=True
        ),
        caption=(
            f"For {excitation.problem.pipeline.duration:.4g} s of a recording, without filter "
            "transients. Logarithmic scale."
        ),
        table=predicted_sigma_table(excitation, range(len(names))),
    )


def _plotted_times(excitation: Excitation) -> Array:
    """Plotted instants of one period, (INSTANT_COUNT,) [s]."""
    return np.linspace(0, excitation.design.motion.period, INSTANT_COUNT)


def _motion_section(excitation: Excitation) -> Section:
    """Section with position, velocity and acceleration of each joint over one period.

    The table compares ranges and largest absolute values with the joint limits.
    """
    times, motion, limits = (
        _plotted_times(excitation),
        excitation.design.motion,
        excitation.rules.limits,
    )
    panels, rows = [], []
    for j, joint in enumerate(excitation.tree.joints):
        q, qd, qdd = (motion.derivative(times, order)[:, j] for order in range(3))
        unit = "rad" if joint.revolute else "m"
        below = {
            f"velocity [{unit}/s]": {"wrench": (times, qd)},
            f"acceleration [{unit}/s²]": {"wrench": (times, qdd)},
        }
        title = f"{joint.name}: position [{unit}]"
        panels.append(
            Panel(title, {"wrench": (times, q)}, "time [s]", lower_plots=below)
        )
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
        explanation="One period, joint by joint; it repeats as often as the recording lasts.",
        panels=panels,
        shown=VISIBLE_JOINTS,
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


def _limit_section(excitation: Excitation) -> Section:
    """Section with the smallest margin of each kind of limit over one period.

    The table has the proven margins to all individual limits.
    """
    times = _plotted_times(excitation)
    panels = [
        Panel(
            f"margin to {kind.label} [{kind.unit}]",
            {"wrench": (times, kind.left)},
            "time [s]",
            from_zero=bool((kind.left >= 0).all()),
        )
        for kind in slack_by_kind(excitation.design.motion, excitation.rules, times)
    ]
    return Section(
        id="limits",
        title="Margins to limits",
        explanation=(
            "Smallest margin to the limits of each kind over time. The table lists margins that "
            "are proven for every instant, between the samples too."
        ),
        panels=panels,
        caption=_limit_caption(excitation),
        table=margin_table(excitation.design.proof.margins),
    )


def _limit_caption(excitation: Excitation) -> str:
    """Sentences on the usable fraction of the limits, required distances, and diagnostics.

    Distances are mentioned only if pairs of bodies are checked for collision.
    """
    rules = excitation.rules
    caption = f"{rules.margin:.0%} of each limit may be used."
    if rules.collision is not None and rules.collision.pairs:
        clearance = 1000 * float(rules.clearance.max())
        caption += (
            f" Distances are between bodies not connected by a joint. The margin is what exceeds "
            f"the required {clearance:g} mm; it is drawn up to {1000 * MAX_DISTANCE:g} mm."
        )
        if rules.clearance.min() < rules.clearance.max():
            caption += " Pairs that keep less are not drawn; the table has them."
    lines = (f"{line[:1].upper()}{line[1:]}." for line in sentences(rules.diagnostics))
    return " ".join([caption, *lines])
