"""Plots of a campaign: figures over factors, coverage, scores, predicted beside obtained sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.campaign.campaign_summary import Figure, ParameterErrors, Summary
from testbed.identification.estimate import METHODS
from testbed.reporting.figures import Panel

LEGEND = {"external": "by the plate", "internal": "by joint torques"}

BINS = np.linspace(-4.0, 4.0, 33)
"""Of scores, in sigmas; what is beyond counts in the outermost ones."""

PANELS = 24
"""Most plots of one kind."""


def marginal_figure(summary: Summary, metrics: Sequence[str]) -> dict[str, Any] | None:
    """Metrics over each factor, the mean over all others.

    Args:
        summary: What the campaign says.
        metrics: Names that begin with the method.
    """
    panels, rows = [], []
    for k, factor in enumerate(summary.factors):
        levels = list(dict.fromkeys(cell[k] for cell in summary.cells.values()))
        named = any(isinstance(level, str) for level in levels)
        curves: dict[str, tuple[Array, Array]] = {}
        for metric in metrics:
            own = [each for each in summary.figures if each.metric == metric]
            means = [_mean([f for f in own if summary.cells[f.cell][k] == x]) for x in levels]
            if own:
                at = np.arange(1.0, len(levels) + 1) if named else np.array(levels, dtype=float)
                curves[metric.partition("_")[0]] = at, 100 * np.array(means)
                rows += [
                    [factor, str(level), metric.replace("_", " "), f"{100 * mean:.3g}"]
                    for level, mean in zip(levels, means, strict=True)
                ]
        log = not named and all(level > 0 for level in levels)
        label = factor
        if named:
            label = ", ".join(f"{n}: {level}" for n, level in enumerate(levels, 1))
        title = "rms relative error [%]"
        bars = {kind: np.zeros(len(levels)) for kind in curves}  # larger points
        shown = tuple(curves)
        panels.append(Panel(title, curves, label, log, shown, bars, whole=named))
    if not panels:
        return None
    return {
        "id": "marginals",
        "title": "Errors over each factor",
        "says": "The mean over all runs of a level, whatever the other factors.",
        "legend": LEGEND,
        "panels": panels,
        "caption": "Rms over the parameters that joint torques can tell.",
        "heads": ["factor", "level", "metric", "mean [%]"],
        "rows": rows,
    }


def _mean(figures: Sequence[Figure]) -> float:
    runs = sum(each.runs for each in figures)
    return sum(each.mean * each.runs for each in figures) / runs if runs else float("nan")


def coverage_figure(every: Sequence[ParameterErrors]) -> dict[str, Any] | None:
    """Share of intervals of 95 % that hold the truth, parameter by parameter.

    Args:
        every: Errors of all cells together.
    """
    panels, rows = [], []
    for method in METHODS:
        own = [each for each in every if each.method == method]
        if not own:
            continue
        number = np.arange(1.0, len(own) + 1)
        bounds = 100 * np.array([each.bounds for each in own])
        middle, half = bounds.mean(axis=1), np.diff(bounds, axis=1)[:, 0] / 2
        wanted = np.array([0.5, len(own) + 0.5]), np.array([95.0, 95.0])
        title = f"{method}: bounds of the coverage [%]"
        label = f"parameter, 1 ({own[0].parameter}) to {len(own)} ({own[-1].parameter})"
        curves = {"measured": wanted, method: (number, middle)}
        panels.append(
            Panel(title, curves, label, points=(method,), bars={method: half}, whole=True)
        )
        rows += [
            [each.parameter, method, str(each.runs), f"{100 * each.coverage:.1f}"] for each in own
        ]
    if not panels:
        return None
    return {
        "id": "coverage",
        "title": "Do intervals of 95 % hold the truth?",
        "says": "A bar for each parameter: the coverage that the number of runs allows, with a "
        "certainty of 95 %. One bar in twenty may miss the line.",
        "legend": {"measured": "95 %"} | LEGEND,
        "panels": panels,
        "caption": "Bounds of Clopper and Pearson.",
        "heads": ["parameter", "method", "runs", "coverage [%]"],
        "rows": rows,
    }


def score_figure(z: Mapping[str, Mapping[str, Array]]) -> dict[str, Any] | None:
    """Errors over sigmas beside the normal law, parameter by parameter.

    Args:
        z: By method and parameter.
    """
    panels: list[Panel] = []
    rows: list[list[str]] = []
    middle = (BINS[1:] + BINS[:-1]) / 2
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    for method, scores in z.items():
        for name, values in scores.items():
            inside = np.clip(values, BINS[0], BINS[-1])
            share = np.histogram(inside, BINS)[0] / len(values) / np.diff(BINS)
            rms = float(np.sqrt(np.mean(values**2)))
            rows.append([name, method, f"{values.mean():.2f}", f"{rms:.2f}"])
            if len(panels) < PANELS:
                stairs = np.repeat(BINS, 2)[1:-1], np.repeat(share, 2)
                curves = {"measured": (middle, normal), method: stairs}
                panels.append(Panel(f"{name}, {method}: rms {rms:.2f}", curves, "error / sigma"))
    if not panels:
        return None
    return {
        "id": "scores",
        "title": "Errors in sigmas",
        "says": "If sigma is honest, errors over sigmas follow the normal law.",
        "legend": {"measured": "normal law"} | LEGEND,
        "panels": panels,
        "caption": f"The first {len(panels)} of {len(rows)} parameters.",
        "heads": ["parameter", "method", "mean of z", "rms of z"],
        "rows": rows,
    }


def sigma_figure(parts: Sequence[ParameterErrors]) -> dict[str, Any] | None:
    """The spread that came out over the sigma that was predicted, a point a parameter and cell.

    Args:
        parts: By cell, method and parameter.
    """
    curves: dict[str, tuple[Array, Array]] = {}
    known = [each for each in parts if each.spread > 0 and each.sigma > 0]
    if not known:
        return None
    ends = np.array([f([each.sigma for each in known]) for f in (min, max)])
    curves["measured"] = ends, ends
    for method in METHODS:
        own = [each for each in known if each.method == method]
        if own:
            curves[method] = np.array([e.sigma for e in own]), np.array([e.spread for e in own])
    points = tuple(kind for kind in curves if kind != "measured")
    return {
        "id": "sigma",
        "title": "Predicted and obtained sigma",
        "says": "Below the line, estimates are better than they say; above it, worse.",
        "legend": {"measured": "as predicted"} | LEGEND,
        "panels": [Panel("obtained sigma", curves, "predicted sigma", log=True, points=points)],
        "caption": "Each in the unit of its parameter.",
        "heads": ["method", "parameters and cells", "median of obtained over predicted"],
        "rows": [
            [m, str(len(curves[m][0])), f"{np.median(curves[m][1] / curves[m][0]):.2f}"]
            for m in points
        ],
    }
