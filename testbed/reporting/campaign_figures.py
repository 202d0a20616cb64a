"""Plots of a campaign: figures over factors, coverage, scores, predicted beside obtained sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from testbed.arrays import Array
from testbed.campaign.summary import Figure, ParameterErrors, Summary
from testbed.identification.estimate import METHODS
from testbed.reporting.figures import Panel, named_panels
from testbed.reporting.section import Section, Table

LEGEND = {"external": "by the plate", "internal": "by joint torques"}

ENOUGH = 20
"""Runs without which no distribution of errors is drawn."""

BINS = np.linspace(-4.0, 4.0, 33)
"""Of scores, in sigmas; what is beyond counts in the outermost ones."""


def marginal_figure(summary: Summary, metrics: Sequence[str]) -> Section | None:
    """Metrics over each factor, the mean over all others.

    Args:
        summary: What the campaign says.
        metrics: Names that begin with the method.
    """
    panels, rows = [], []
    for k, factor in enumerate(summary.factors):
        levels = list(dict.fromkeys(cell[k] for cell in summary.cells.values()))
        named = any(isinstance(level, str) for level in levels)
        curves: dict[str, Array] = {}
        for metric in metrics:
            own = [each for each in summary.figures if each.metric == metric]
            means = [_mean([f for f in own if summary.cells[f.cell][k] == x]) for x in levels]
            if own:
                curves[metric.partition("_")[0]] = 100 * np.array(means)
                rows += [
                    [factor, str(level), metric.replace("_", " "), f"{100 * mean:.3g}"]
                    for level, mean in zip(levels, means, strict=True)
                ]
        title = "rms relative error [%]"
        if named:
            panels += named_panels(factor, [str(level) for level in levels], curves, title)
        else:
            at, log = np.array(levels, dtype=float), all(level > 0 for level in levels)
            shown = {kind: (at, means) for kind, means in curves.items()}
            panels.append(Panel(title, shown, factor, log, tuple(curves)))
    if not panels:
        return None
    return Section(
        id="marginals",
        title="Errors over each factor",
        says="The mean over the runs of a level that have a result, whatever the other factors.",
        legend=_legend(panels),
        panels=panels,
        caption="Rms over the parameters that joint torques can tell.",
        table=Table(["factor", "level", "metric", "mean [%]"], rows),
    )


def _legend(panels: Sequence[Panel]) -> dict[str, str]:
    """Of the methods that are drawn."""
    return {k: label for k, label in LEGEND.items() if any(k in each.curves for each in panels)}


def _mean(figures: Sequence[Figure]) -> float:
    runs = sum(each.runs for each in figures)
    return sum(each.mean * each.runs for each in figures) / runs if runs else float("nan")


def coverage_figure(every: Sequence[ParameterErrors]) -> Section | None:
    """Share of intervals of 95 % that hold the truth, parameter by parameter.

    Args:
        every: Errors of all cells together.
    """
    names = list(dict.fromkeys(each.parameter for each in every))
    shares: dict[str, Array] = {}
    bars: dict[str, tuple[Array, Array]] = {}
    rows = []
    for method in METHODS:
        own = {each.parameter: each for each in every if each.method == method}
        if not own:
            continue
        found = np.full((3, len(names)), np.nan)
        for k, name in enumerate(names):
            if name in own:
                found[:, k] = own[name].coverage, *own[name].bounds
        shares[method], *ends = 100 * found
        bars[method] = ends[0], ends[1]
        rows += [
            [each.parameter, method, str(each.runs), f"{100 * each.coverage:.1f}"]
            for each in own.values()
        ]
    if not rows:
        return None
    title = "share that hold the truth"
    panels = named_panels(title, names, shares, "coverage [%]", bars=bars, line=95.0)
    return Section(
        id="coverage",
        title="Do intervals of 95 % hold the truth?",
        says=(
            "Points are the share of intervals that hold the truth; bars, the coverage that so "
            "many runs allow, with a certainty of 95 %. One bar in twenty may miss the line."
        ),
        legend={"measured": "95 %"} | _legend(panels),
        panels=panels,
        caption="Bounds of Clopper and Pearson.",
        table=Table(["parameter", "method", "runs", "coverage [%]"], rows),
    )


def score_figure(z: Mapping[str, Mapping[str, Array]]) -> Section | None:
    """Errors over sigmas of all parameters beside the normal law; None of fewer than ENOUGH runs.

    Args:
        z: By method and parameter.
    """
    panels: list[Panel] = []
    rows: list[list[str]] = []
    middle = (BINS[1:] + BINS[:-1]) / 2
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    for method, every in z.items():
        scores = {name: values for name, values in every.items() if len(values) >= ENOUGH}
        if not scores:
            continue
        rows += [
            [name, method, f"{values.mean():.2f}", f"{_rms(values):.2f}"]
            for name, values in scores.items()
        ]
        pooled = np.concatenate(list(scores.values()))
        inside = np.clip(pooled, BINS[0], BINS[-1])
        share = np.histogram(inside, BINS)[0] / len(pooled) / np.diff(BINS)
        stairs = np.repeat(BINS, 2)[1:-1], np.repeat(share, 2)
        title = f"{LEGEND[method]}: density of {len(pooled)} errors, rms {_rms(pooled):.2f}"
        curves = {"measured": (middle, normal), method: stairs}
        panels.append(Panel(title, curves, "error / sigma", from_zero=True))
    if not panels:
        return None
    return Section(
        id="scores",
        title="Errors in sigmas",
        says="If sigma is honest, errors over sigmas follow the normal law.",
        legend={"measured": "normal law"} | _legend(panels),
        panels=panels,
        caption="All parameters and runs; the table has them one by one.",
        table=Table(["parameter", "method", "mean of z", "rms of z"], rows),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def sigma_figure(parts: Sequence[ParameterErrors]) -> Section | None:
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
    panel = Panel("obtained sigma", curves, "predicted sigma", log=True, points=points)
    return Section(
        id="sigma",
        title="Predicted and obtained sigma",
        says="Below the line, estimates are better than they say; above it, worse.",
        legend={"measured": "as predicted"} | _legend([panel]),
        panels=[panel],
        caption="Each in the unit of its parameter.",
        table=Table(
            ["method", "parameters and cells", "median of obtained over predicted"],
            [
                [m, str(len(curves[m][0])), f"{np.median(curves[m][1] / curves[m][0]):.2f}"]
                for m in points
            ],
        ),
    )
