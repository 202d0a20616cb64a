"""A designed motion as a page: what it promises, how it moves, what it leaves of its limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import sentences
from testbed.errors import plural
from testbed.excitation.clearance import FAR
from testbed.excitation.slack import slack
from testbed.experiment.excite import Excitation
from testbed.files import replacing
from testbed.reporting.figures import Panel
from testbed.reporting.html import rendered
from testbed.reporting.named_panels import named_panels

INSTANTS = 400
"""Of a period that are drawn."""

SHOWN = 6
"""Joints that are not folded away."""


def write_motion_page(path: Path, found: Excitation) -> None:
    """Write the page of a motion.

    Args:
        path: The HTML file; what stands there is replaced.
        found: The motion.
    """
    text = rendered("motion.html", motion_contents(found))
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")


def motion_contents(found: Excitation) -> dict[str, Any]:
    """All that the page shows."""
    motion, proof = found.design.motion, found.design.proof
    return {
        "title": f"Motion of {found.tree.name}",
        "summary": [
            f"{plural(motion.harmonics, 'harmonic')} of {motion.fundamental:g} Hz; "
            "predicted rms of the "
            f"relative sigmas {found.predicted.rms:.2g}, {found.beside_random}.",
            *(f"Warning: {line}." for line in sentences(found.diagnostics)),
        ],
        "holds": proof.holds,
        "verdict": f"all {plural(len(proof.margins), 'limit')} proven at every moment"
        if proof.holds
        else f"not proven: {proof.worst.words}",
        "figures": [_sigma_figure(found), _motion_figure(found), _limit_figure(found)],
    }


def _sigma_figure(found: Excitation) -> dict[str, Any]:
    names, promised = found.predicted.names, found.predicted.relative
    random = None if found.gain is None else found.random_predicted
    values = {} if random is None else {"measured": 100 * random.relative}
    values["external"] = 100 * promised
    others = [""] * len(names) if random is None else [f"{v:.3%}" for v in random.relative]
    return {
        "id": "sigma",
        "title": "What it promises",
        "says": "The standard deviation that each parameter will have from white noise of this "
        "instrument, before anything has run: of this motion, and of the best random one.",
        "legend": {"measured": "random motion", "external": "this motion"}
        if random is not None
        else {"external": "this motion"},
        "panels": named_panels("sigma", names, values, "sigma, part of the value [%]", log=True),
        "caption": f"A recording of {found.experiment.motion.duration:g} s, its filters' ends off. "
        "Logarithmic; further to the left is better.",
        "heads": ["parameter", "sigma", "of its value", "random motion"],
        "rows": [
            [name, f"{found.predicted.sigma[k]:.2g}", f"{promised[k]:.3%}", others[k]]
            for k, name in enumerate(names)
        ],
    }


def _times(found: Excitation) -> Array:
    return np.linspace(0, found.design.motion.period, INSTANTS)


def _motion_figure(found: Excitation) -> dict[str, Any]:
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
    return {
        "id": "motion",
        "title": "How it moves",
        "says": "One period, joint by joint; it repeats as often as the recording lasts.",
        "legend": {},
        "panels": panels,
        "shown": SHOWN,
        "caption": "",
        "heads": ["joint", "position", "allowed", "largest velocity", "largest acceleration"],
        "rows": rows,
    }


def _limit_figure(found: Excitation) -> dict[str, Any]:
    times = _times(found)
    panels = [
        Panel(
            f"left of {kind.label} [{kind.unit}]",
            {"external": (times, kind.left)},
            "time [s]",
            from_zero=bool((kind.left >= 0).all()),
        )
        for kind in slack(found.design.motion, found.rules, times)
    ]
    return {
        "id": "limits",
        "title": "What it leaves of its limits",
        "says": "At every instant, what the nearest limit of each kind leaves of what may be used. "
        "The table holds what is proven, between the instants too.",
        "legend": {},
        "panels": panels,
        "caption": _allowed(found),
        "heads": ["limit on", "left", "at t [s]"],
        "rows": [
            [m.label, f"{1000 * m.left:.1f} mm" if m.unit else f"{m.left:.2%}", f"{m.instant:.3f}"]
            for m in sorted(found.design.proof.margins, key=lambda margin: margin.left)
        ],
    }


def _allowed(found: Excitation) -> str:
    rules = found.rules
    said = f"{rules.margin:.0%} of each limit may be used."
    if rules.collision is not None and rules.collision.pairs:
        least = 1000 * float(rules.clearance.max())
        said += (
            f" Distances are of shapes that no joint joins. {least:g} mm are to be kept; what is "
            f"left of a clearance is beyond these, and {1000 * FAR:g} mm or more are drawn as that."
        )
        if rules.clearance.min() < rules.clearance.max():
            said += " Pairs that keep less are not drawn; the table has them."
    lines = (f"{line[:1].upper()}{line[1:]}." for line in sentences(rules.diagnostics))
    return " ".join([said, *lines])
