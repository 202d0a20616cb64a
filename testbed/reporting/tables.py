"""Results as tables for the terminal. No number is ever cut off: the table splits instead."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.box import HEAVY_HEAD, SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from testbed.errors import plural, printable
from testbed.identification.estimate_text import number_with_sigma
from testbed.identification.influence import by_influence
from testbed.reporting.widths import first_that_fits

_NAME = 12
"""Columns that are left to a name, at least, when it gives way."""

if TYPE_CHECKING:
    from testbed.identification.estimate import Estimate


@dataclass(frozen=True)
class _Layout:
    """How much a table shows, from wide to narrow."""

    short: bool  # 1.0610(9) for 1.0610 +- 0.0009
    units: bool
    together: bool  # all methods in one table
    folded: bool  # names are folded


_LAYOUTS = (
    _Layout(short=False, units=True, together=True, folded=False),
    _Layout(short=True, units=False, together=True, folded=False),
    _Layout(short=True, units=False, together=False, folded=False),
    _Layout(short=True, units=False, together=False, folded=True),
)


def result_tables(
    console: Console,
    estimates: Sequence[Estimate],
    truths: Mapping[str, float],
    title: str = "",
    most: int | None = None,
) -> list[Table]:
    """What every method found: value and sigma, and, where it is known, the truth beside it.

    First what adds most to the predicted signals. The widest layout that fits is taken.

    Args:
        console: Where the tables are to be printed.
        estimates: Of one recording, one a method.
        truths: True values by name; {} where they are not known.
        title: Of the table.
        most: Rows in all; None for all that there are.
    """
    names = by_influence(estimates, truths)[:most]

    def laid_out(layout: _Layout) -> list[Table]:
        groups = [list(estimates)] if layout.together else [[e] for e in estimates]
        width = console.width if layout.folded else None
        return [_table(group, names, truths, title, layout, width) for group in groups]

    return first_that_fits(console, map(laid_out, _LAYOUTS))


def _table(
    estimates: Sequence[Estimate],
    names: Sequence[str],
    truths: Mapping[str, float],
    title: str,
    layout: _Layout,
    width: int | None,
) -> Table:
    units = {n: u for e in estimates for n, u in zip(e.names, e.units, strict=True)}
    rows = {
        name: [
            *([units[name]] if layout.units else []),
            *([_number(truths.get(name))] if truths else []),
            *(cell for e in estimates for cell in _cells(e, name, truths, layout.short)),
        ]
        for name in names
        if name in units
    }
    table = Table(
        title=printable(title) or None,
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD if layout.short else HEAVY_HEAD,
    )
    heads = ["unit"] * layout.units + ["truth"] * bool(truths)
    for estimate in estimates:
        heads += [estimate.method, *(["z" if layout.short else "error/sigma"] * bool(truths))]
    taken = [max(len(h), *(len(r[k]) for r in rows.values()), 0) for k, h in enumerate(heads)]
    room = None if width is None else max(_NAME, width - sum(taken) - 3 * len(taken) - 4)
    table.add_column("parameter", overflow="fold", max_width=room, no_wrap=room is None)
    for head in heads:
        style = "dim" if head == "unit" else ""
        table.add_column(head, justify="left" if style else "right", no_wrap=True, style=style)
    for name, cells in rows.items():
        table.add_row(printable(name), *cells)
    return table


def quality_lines(estimates: Iterable[Estimate]) -> list[str]:
    """One line an estimate: number of unknowns, condition, noise, residual of each channel."""
    lines = []
    for e in estimates:
        fits = ", ".join(f"{c} {r:.3g}" for c, r in zip(e.channels, e.residual, strict=True))
        lines.append(
            f"{e.method}: {plural(len(e.names), 'unknown')}, condition {e.condition:.1f}, "
            f"{_noise(e)}"
            f"residual rms {fits}"
        )
        lines += [f"{e.method}: {part}" for part in _instrument(e)]
    return lines


def _instrument(estimate: Estimate) -> list[str]:
    """What was estimated of the instrument, a line each kind; whether sigma is to be doubted."""
    kinds: dict[str, list[str]] = {}
    for each in estimate.nuisances:
        number = f"{each.name} {each.value:.4g} +- {each.sigma:.2g} {each.unit}".rstrip()
        kinds.setdefault(each.kind, []).append(number)
    lines = [", ".join(numbers) for numbers in kinds.values()]
    if estimate.doubtful:
        lines.append("doubtful: sigma does not count what the warnings say")
    return lines


def _noise(estimate: Estimate) -> str:
    """How long the noise lasts and what that does to sigma."""
    noise = estimate.noise
    if noise is None:
        return ""
    constants = ", constants estimated" if noise.bias_weight > 0.5 else ""
    hidden = [name for name in noise.hidden if name not in estimate.unidentifiable]
    rests = f", {', '.join(hidden)} if the plate's zero is right" if hidden else ""
    return (
        f"noise of {max(noise.memory):.2g} s (sigma x {noise.factor:.2f} by bootstrap{constants}"
        f"{rests}), "
    )


def _cells(
    estimate: Estimate, name: str, truths: Mapping[str, float], short: bool
) -> tuple[str, ...]:
    """Value with sigma, and, where truths are known, the error in sigmas."""
    value = with_sigma(estimate, name, short=short or name in estimate.unidentifiable)
    if not truths:
        return (value,)
    if name not in estimate.names or name not in truths:
        return value, ""
    k = estimate.names.index(name)
    sigma = float(estimate.sigma[k])
    if math.isinf(sigma):
        return value, ""
    z = (float(estimate.values[k]) - truths[name]) / sigma if sigma > 0 else 0.0
    return value, f"{z:+.1f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def with_sigma(estimate: Estimate, name: str, short: bool = False) -> str:
    """Value and sigma, with as many decimals as sigma has to say; "-" if it is not there.

    Args:
        estimate: Where to look.
        name: Of the parameter.
        short: 1.0610(9) for 1.0610 +- 0.0009: the digits in brackets are of the last places.
    """
    if name not in estimate.names:
        return "-"
    k = estimate.names.index(name)
    return number_with_sigma(float(estimate.values[k]), float(estimate.sigma[k]), short)
