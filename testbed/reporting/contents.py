"""What a report says, as plain data: for the page, and as JSON beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.diagnostics.diagnostic import sentences
from testbed.errors import plural
from testbed.experiment.predictions import predict
from testbed.experiment.run import Run
from testbed.experiment.summary import obtained, summary, verdict
from testbed.identification.estimate import Estimate
from testbed.identification.estimate_text import OPEN_ZERO
from testbed.identification.influence import by_influence
from testbed.parameters.barycentric import STANDARD
from testbed.parameters.identifiability import identifiability
from testbed.reporting.error_dots import dots_section
from testbed.reporting.facts import asked, origin
from testbed.reporting.instrument_tables import instrument_tables
from testbed.reporting.matrix_map import matrix_maps
from testbed.reporting.portrait import portrait
from testbed.reporting.sections import SHOWN, seconds_shown, sections
from testbed.reporting.tables import with_sigma
from testbed.robot.free_base import FREE
from testbed.robot.tree import Tree
from testbed.robot.visuals.appearance import Appearance, load_appearance

GLYPHS = ("·", "+", "#")
KINDS = ("never", "combined", "alone")
SAYS = ("never", "only in combination", "alone")

WIDEST = 5.0
"""Errors in sigmas that fill half a bar."""

LONGEST = 21
"""Characters of a value and its sigma with a sign between them; longer, sigma is in brackets."""


def contents(run: Run) -> dict[str, Any]:
    """Everything that the page shows; drawings know their "svg".

    Args:
        run: What the report is about.
    """
    look = load_appearance(run.tree, run.model)
    return {
        "title": run.name,
        "claim": "" if run.experiment is None else run.experiment.claim,
        "summary": summary(run),
        "verdict": verdict(run),
        "verdicts": _verdicts(run),
        "holds": run.as_expected,
        "portrait": _portrait(run, look),
        "asked": asked(run),
        "methods": list(run.estimates),
        "has_truth": bool(run.truths),
        "parameters": parameter_rows(run),
        "in_brackets": _in_brackets(run),
        "diagnostics": sentences([*run.diagnostics, *look.diagnostics]),
        "errors": dots_section(run),
        "figures": sections(predict(run, run.unseen)),
        "instrument": instrument_tables(run),
        "matrix": matrix_maps(run),
        "maps": _maps(run.tree, run.settings.zeros),
        "zeros": bool(run.settings.zeros),
        "origin": origin(run),
    }


def _verdicts(run: Run) -> list[dict[str, Any]]:
    """Claims, and what came out."""
    expect = {} if run.experiment is None else run.experiment.expect
    return [
        {
            "name": name.replace("_", " "),
            "wanted": bound.wanted,
            "value": obtained(run, name),
            "holds": run.verdicts[name],
        }
        for name, bound in expect.items()
    ]


def _portrait(run: Run, look: Appearance) -> dict[str, str]:
    """The robot as the recording begins, with the reaction at that moment."""
    recording = run.recording
    shown = recording.time <= recording.time[0] + SHOWN
    step = max(1, int(shown.sum()) // 500)
    wrench = None if recording.wrench is None else recording.wrench[0]
    name = f"The robot {run.tree.name} on its bedplate"
    paths = f"the paths of its ends over {seconds_shown(recording.time):.3g} s"
    caption = f"The robot as the recording begins, and {paths}."
    if wrench is not None:
        caption += (
            " Red and blue, the bedplate's force and moment on it at that moment, about the "
            "bedplate's origin."
        )
    motion = recording.position[shown][::step]
    return {"svg": portrait(look, motion, wrench, name), "caption": caption}


def parameter_rows(run: Run) -> list[dict[str, Any]]:
    """Every parameter by every method: first what adds most to the predicted signals.

    Args:
        run: The run.
    """
    units = {n: u for e in run.estimates.values() for n, u in zip(e.names, e.units, strict=True)}
    rows, short = [], _in_brackets(run)
    for name in by_influence(run.estimates.values(), run.truths):
        truth = run.truths.get(name)
        rows.append(
            {
                "name": name,
                "unit": units[name],
                "truth": "" if truth is None else f"{truth:.6g}",
                "cells": [_cell(e, name, truth, short) for e in run.estimates.values()],
            }
        )
    return rows


def _in_brackets(run: Run) -> bool:
    """Whether values would be too long for a page with their sigmas after a sign."""
    every = (
        with_sigma(e, name)
        for e in run.estimates.values()
        for name in e.names
        if name not in e.unidentifiable
    )
    return any(len(text.replace("+-", "±")) > LONGEST for text in every)


def _cell(estimate: Estimate, name: str, truth: float | None, short: bool) -> dict[str, Any]:
    """One method's value, and its error as a bar where the truth is known."""
    cell: dict[str, Any] = {
        "method": estimate.method,
        "text": with_sigma(estimate, name, short),
        "value": None,
        "sigma": None,
        "z": None,
    }
    if name not in estimate.names:
        return cell
    k = estimate.names.index(name)
    if name in estimate.unidentifiable:
        return cell | {"text": OPEN_ZERO}
    value, sigma = float(estimate.values[k]), float(estimate.sigma[k])
    cell |= {"value": value, "sigma": sigma}
    if truth is not None:
        z = (value - truth) / sigma if sigma > 0 else 0.0
        share = min(abs(z) / WIDEST, 1.0) * 50.0
        left = 50.0 if z > 0 else 50.0 - share
        cell |= {"z": z, "shown": f"{z:+.1f}", "left": round(left, 1), "width": round(share, 1)}
    return cell


def _maps(tree: Tree, zeros: bool | Sequence[str]) -> list[dict[str, Any]]:
    """What joint torques, and what the bedplate, can tell of each link's ten parameters."""
    tables = []
    maps = identifiability(tree, zeros=zeros)[:2]
    first = FREE - 1 if tree.floating else 0  # what carries a base's coordinates has no matter
    names = [tree.joints[k].body if k < FREE else name for k, name in enumerate(tree.names)]
    for seen in maps[1:] if tree.floating else maps:
        rows = []
        shown = names[first:] if tree.floating else tree.names
        for name, codes in zip(shown, seen.standard[first:], strict=True):
            cells = [{"glyph": GLYPHS[k], "kind": KINDS[k], "says": SAYS[k]} for k in codes]
            rows.append((name, cells))
        title = f"{seen.instrument}: {plural(seen.count, 'combination')}"
        tables.append({"title": title, "names": STANDARD, "rows": rows})
    return tables
