"""A report one can send: one HTML file with everything in it, and its numbers as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from testbed.files import replacing
from testbed.parameters.barycentric import STANDARD
from testbed.parameters.identifiability import identifiability
from testbed.report.contents import (
    Check,
    Subject,
    check,
    friction_points,
    notes,
    parameter_rows,
)
from testbed.report.figures import panels, spectrum, thinned

GLYPHS = ("·", "+", "#")
KINDS = ("never", "combined", "alone")
SAYS = ("never", "only in combination", "alone")
SHOWN = 10.0
"""Seconds of a motion that are drawn."""


def write_report(subject: Subject, path: Path) -> Path:
    """Write a report, and its numbers beside it.

    Args:
        subject: What it is about.
        path: The HTML file.

    Returns:
        The JSON file: of the same name, ending in .json.
    """
    content = contents(subject)
    page = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string(files("testbed.report").joinpath("page/report.html").read_text("utf-8"))
    text = page.render(content)
    beside = path.with_suffix(".json")
    with replacing(path) as fresh, replacing(beside) as numbers:
        fresh.write_text(text, encoding="utf-8")
        numbers.write_text(json.dumps(_plain(content), indent=1, sort_keys=True) + "\n", "utf-8")
    return beside


def contents(subject: Subject) -> dict[str, Any]:
    """Everything that the page shows.

    Args:
        subject: What the report is about.
    """
    found = check(subject)
    return {
        "title": subject.title,
        "claim": subject.claim,
        "verdicts": [dict(row) for row in subject.verdicts],
        "holds": all(row["holds"] for row in subject.verdicts),
        "asked": list(subject.asked),
        "methods": ["external", "internal"],
        "has_truth": bool(subject.truths),
        "parameters": parameter_rows(subject),
        "notes": notes(subject),
        "figures": [
            _predictions(subject, found),
            _spectra(found, subject),
            _friction(subject, found),
        ],
        "maps": _maps(subject),
        "origin": list(subject.origin),
    }


def _predictions(subject: Subject, raw: Check) -> dict[str, Any]:
    found = raw.smooth()
    shown = found.time <= found.time[0] + SHOWN
    curves = []
    for c in range(len(found.channels)):
        sets = {"measured": found.measured, "external": found.external, "internal": found.internal}
        curves.append(
            {name: thinned(found.time[shown], values[shown, c]) for name, values in sets.items()}
        )
    unseen = subject.unseen is not None
    motion = "a motion that no estimate has seen" if unseen else "the motion that was identified"
    return {
        "id": "prediction",
        "title": f"Measured and predicted, on {motion}",
        "says": "Forces and moments of the bedplate, then joint torques. The external estimate "
        "knows no friction, so its torques are those of a robot that does not rub; the internal "
        "one takes from the external what joint torques cannot tell.",
        "svg": Markup(
            panels(
                [f"{c}" for c in found.channels],
                curves,
                "time [s]",
                [f"[{u}]" for u in found.units],
                name=f"Measured and predicted wrench and joint torques on {motion}",
            )
        ),
        "caption": "All through one low-pass of 10 Hz; residuals as part of the signal's spread "
        "stand in the table.",
        "heads": [
            "channel",
            "unit",
            "spread (rms)",
            "residual rms, external",
            "residual rms, internal",
            "of spread, external",
            "of spread, internal",
        ],
        "rows": _residuals(found),
    }


def _residuals(found: Check) -> list[list[str]]:
    """Per channel: spread, residuals, and these as part of the spread."""
    rows = []
    pair = found.relative(found.external), found.relative(found.internal)
    spreads = found.measured.std(axis=0)
    for c, (channel, unit) in enumerate(zip(found.channels, found.units, strict=True)):
        shares = [float(share[c]) for share in pair]
        sizes = [float(spreads[c]), *(share * float(spreads[c]) for share in shares)]
        numbers = [*(f"{x:.3g}" for x in sizes), *(f"{x:.2%}" for x in shares)]
        rows.append([channel, unit, *numbers])
    return rows


def _spectra(found: Check, subject: Subject) -> dict[str, Any]:
    rate = subject.recording.rate
    curves, rows = [], []
    for c, channel in enumerate(found.channels):
        both = {"external": found.external, "internal": found.internal}
        if c >= 6:  # friction is not the external estimate's to tell
            both.pop("external")
        spectra = {
            name: spectrum(found.measured[:, c] - values[:, c], rate)
            for name, values in both.items()
        }
        curves.append(spectra)
        rows.append([channel, found.units[c], *_bands(spectra)])
    return {
        "id": "spectra",
        "title": "What is left over, by frequency",
        "says": "Amplitude density of the residuals. White noise of the instrument is flat, noise "
        "of the encoders rises until the filter on positions ends it; what stands at the motion's "
        "frequencies is a part of the robot, or of its friction, that the model lacks.",
        "svg": Markup(
            panels(
                list(found.channels),
                curves,
                "frequency [Hz]",
                [f"[{u}/√Hz]" for u in found.units],
                log=True,
                name="Spectra of the residuals",
            )
        ),
        "caption": "Welch's method, segments of at most 2048 samples.",
        "heads": ["channel", "unit", "rms below 5 Hz", "rms above 5 Hz", "of"],
        "rows": rows,
    }


def _bands(spectra: dict[str, Any]) -> Sequence[str]:
    """Rms of the first method's residual below and above 5 Hz."""
    name, (frequency, density) = next(iter(spectra.items()))
    step = frequency[1] - frequency[0]
    slow = frequency < 5.0
    low, high = (float(np.sqrt(np.sum(density[part] ** 2) * step)) for part in (slow, ~slow))
    return f"{low:.3g}", f"{high:.3g}", name


def _friction(subject: Subject, found: Check) -> dict[str, Any]:
    rest, model = friction_points(subject, found)
    curves, rows = [], []
    values = dict(zip(subject.internal.names, subject.internal.values, strict=True))
    for j, joint in enumerate(subject.tree.joints):
        order = np.argsort(found.speed[:, j])
        speed = found.speed[order, j]
        curves.append(
            {
                "measured": thinned(found.speed[:, j], rest[:, j], 2000),
                "internal": thinned(speed, model[order, j], 2000),
            }
        )
        pair = [values.get(f"{kind}/{joint.name}") for kind in ("coulomb", "viscous")]
        truth = [subject.truths.get(f"{kind}/{joint.name}") for kind in ("coulomb", "viscous")]
        cells = [*pair, *truth]
        kind = "N m, N m s/rad" if joint.revolute else "N, N s/m"
        rows.append([joint.name, kind, *("" if x is None else f"{x:.4g}" for x in cells)])
    units = ["N m" if joint.revolute else "N" for joint in subject.tree.joints]
    return {
        "id": "friction",
        "title": "Friction",
        "says": "Measured motor torque less what the robot needs by the bedplate's estimate, over "
        "velocity: what rubs, and what the drives report wrongly. The line is the internal "
        "estimate's friction.",
        "svg": Markup(
            panels(
                list(subject.tree.names),
                curves,
                "velocity [rad/s or m/s]",
                [f"torque [{u}]" for u in units],
                points=("measured",),
                name="Friction torque over velocity, a panel a joint",
            )
        ),
        "caption": "Points are samples, the line is dry and viscous friction as estimated.",
        "heads": [
            "joint",
            "units",
            *(f"{a}, {b}" for b in ("found", "true") for a in ("dry", "viscous")),
        ],
        "rows": rows,
    }


def _maps(subject: Subject) -> list[dict[str, Any]]:
    tables = []
    for seen in identifiability(subject.tree)[:2]:
        rows = []
        for name, codes in zip(subject.tree.names, seen.standard, strict=True):
            cells = [{"glyph": GLYPHS[k], "kind": KINDS[k], "says": SAYS[k]} for k in codes]
            rows.append((name, cells))
        title = f"{seen.instrument}: {seen.count} combinations"
        tables.append({"title": title, "names": STANDARD, "rows": rows})
    return tables


def _plain(content: dict[str, Any]) -> dict[str, Any]:
    """The page's data without its drawings."""
    figures = [
        {key: value for key, value in figure.items() if key != "svg"}
        for figure in content["figures"]
    ]
    return content | {"figures": figures}
