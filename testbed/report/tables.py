"""Results as tables for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import HEAVY_HEAD, SIMPLE_HEAD
from rich.table import Table

_EXACT = 1e-7
"""Relative sigma below which decimals would hide how small it is."""

if TYPE_CHECKING:
    from testbed.identification.estimate import Estimate


def result_table(
    external: Estimate,
    internal: Estimate,
    truths: Mapping[str, float],
    title: str,
    narrow: bool = False,
) -> Table:
    """Truth, both estimates and their errors in sigmas: Table 6, with the truth beside it.

    First the parameters that both methods know, then what only the plate tells, then
    friction, which only the torques tell.

    Args:
        external: Estimate from the plate.
        internal: Estimate from the motor torques.
        truths: True values by name.
        title: Of the table.
        narrow: Fit 80 columns: 1.0610(9) for 1.0610 +- 0.0009, and no units.
    """
    box = SIMPLE_HEAD if narrow else HEAVY_HEAD
    table = Table(title=title, title_justify="left", header_style="bold", box=box)
    table.add_column("parameter", no_wrap=True)
    if not narrow:
        table.add_column("unit", style="dim")
    error = "z" if narrow else "error/sigma"
    for column in ("truth", "external", error, "internal", error):
        table.add_column(column, justify="right", no_wrap=True)
    shared = internal.base.names
    names = dict.fromkeys((*shared, *external.names, *internal.names))
    sections = {len(shared) - 1, len(names) - 1 - len(internal.joint_terms)}
    units = dict(zip(internal.names, internal.units, strict=True)) | dict(
        zip(external.names, external.units, strict=True)
    )
    for k, name in enumerate(names):
        cells = [
            cell for e in (external, internal) for cell in _cells(e, name, truths[name], narrow)
        ]
        heads = [name] if narrow else [name, units[name]]
        table.add_row(*heads, f"{truths[name]:.6g}", *cells, end_section=k in sections)
    return table


def estimate_table(estimates: Sequence[Estimate], narrow: bool = False) -> Table:
    """Estimates without truth: value and sigma by method.

    Args:
        estimates: Of one recording.
        narrow: Fit 80 columns, as in `result_table`.
    """
    table = Table(header_style="bold", box=SIMPLE_HEAD if narrow else HEAVY_HEAD)
    table.add_column("parameter", no_wrap=True)
    table.add_column("unit", style="dim")
    for estimate in estimates:
        table.add_column(estimate.method, justify="right")
    units = {n: u for e in estimates for n, u in zip(e.names, e.units, strict=True)}
    for name, unit in units.items():
        cells = (with_sigma(estimate, name, short=narrow) for estimate in estimates)
        table.add_row(name, unit, *cells)
    return table


def quality_lines(estimates: Iterable[Estimate]) -> list[str]:
    """One line an estimate: number of unknowns, condition, residual of each channel."""
    lines = []
    for e in estimates:
        fits = ", ".join(f"{c} {r:.3g}" for c, r in zip(e.channels, e.residual, strict=True))
        lines.append(
            f"{e.method}: {len(e.names)} unknowns, condition {e.condition:.1f}, residual rms {fits}"
        )
    return lines


def _cells(estimate: Estimate, name: str, truth: float, narrow: bool) -> tuple[str, str]:
    if name not in estimate.names:
        return "-", ""
    k = estimate.names.index(name)
    sigma = estimate.sigma[k]
    z = (estimate.values[k] - truth) / sigma if sigma > 0 else 0.0
    return with_sigma(estimate, name, short=narrow), f"{z:+.1f}"


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
    value, sigma = float(estimate.values[k]), float(estimate.sigma[k])
    if sigma < _EXACT * abs(value):
        return f"{value:.9g} +- {sigma:.0e}"
    digits = _digits(sigma)
    if short:
        places = f"{sigma:.{digits}f}".replace(".", "").lstrip("0")
        return f"{value:.{digits}f}({sigma:.1f})" if sigma >= 1 else f"{value:.{digits}f}({places})"
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"


def _digits(sigma: float) -> int:
    """Decimals that show two digits of sigma."""
    return 1 if sigma >= 1 or sigma == 0 else len(f"{1 / sigma:.0f}") + 1
