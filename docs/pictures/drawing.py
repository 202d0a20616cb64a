"""Drawings of the pages as SVG files, in the report's colours, light and dark."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

HERE = Path(__file__).parent
STYLE = HERE.parent.parent / "testbed/view/page/style.css"
COLOURS = re.compile(
    r"(?:@media \(prefers-color-scheme: dark\) \{ )?:root \{.*?\}(?: \})?", re.DOTALL
)
ROW = 22
"""Height of a line of a plot [pixels]."""
CELL = 28
"""Height of a row of a table [pixels]."""
LEFT, LONG = 120, 440
"""Where a plot's scale begins, and how long it is [pixels]."""


def save(name: str, width: float, height: float, parts: Sequence[str], title: str) -> None:
    """Write a drawing.

    Args:
        name: Of the file, without its ending.
        width: [pixels].
        height: [pixels].
        parts: Elements.
        title: What it shows, for those who cannot see it.
    """
    style = " ".join(COLOURS.findall(STYLE.read_text())[:2])
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'width="{width:g}" height="{height:g}" role="img" font-family="system-ui, sans-serif" '
        f'font-size="14"><title>{escape(title)}</title><style>{style} text {{ fill: var(--ink) }}'
        f"</style>{''.join(parts)}</svg>\n"
    )
    path = HERE / f"{name}.svg"
    path.parent.mkdir(exist_ok=True)
    path.write_text(re.sub(r'(?<=[ ",]|-)(\d+\.\d{2})\d+(?=[ ",])', r"\1", text))


def placed(svg: str, x: float, y: float, width: float, height: float) -> str:
    """A drawing within another one.

    Args:
        svg: As an element.
        x: To the right [pixels].
        y: Down [pixels].
        width: [pixels].
        height: [pixels].
    """
    return svg.replace("<svg", f'<svg x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"', 1)


def words(
    x: float, y: float, text: str, anchor: str = "start", style: str = "", colour: str = "ink"
) -> str:
    """A line of text."""
    return (
        f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" style="fill: var(--{colour}); {style}">'
        f"{escape(text)}</text>"
    )


def line(
    ends: tuple[float, float, float, float], colour: str = "ink", width: float = 1.5, more: str = ""
) -> str:
    """A straight line: x, y to x, y."""
    x0, y0, x1, y1 = ends
    return (
        f'<line x1="{x0:g}" y1="{y0:g}" x2="{x1:g}" y2="{y1:g}" stroke="var(--{colour})" '
        f'stroke-width="{width:g}" stroke-linecap="round" {more}/>'
    )


def dot(x: float, y: float, radius: float, colour: str, more: str = "") -> str:
    """A filled circle."""
    return f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="var(--{colour})" {more}/>'


def square(x: float, y: float, side: float, share: float) -> str:
    """A square in the colour of the plate's estimates, more or less full."""
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{side:g}" height="{side:g}" rx="3" '
        f'fill="var(--wrench)" fill-opacity="{share:g}" stroke="var(--line)"/>'
    )


def arrow(x0: float, y0: float, x1: float, y1: float, colour: str, width: float = 3) -> str:
    """A line with a head."""
    length = math.hypot(x1 - x0, y1 - y0)
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    size = 3.2 * width
    bx, by = x1 - size * ux, y1 - size * uy
    head = " ".join(
        f"{x:.1f},{y:.1f}"
        for x, y in (
            (x1, y1),
            (bx - uy * size / 2, by + ux * size / 2),
            (bx + uy * size / 2, by - ux * size / 2),
        )
    )
    return (
        line((x0, y0, bx, by), colour, width) + f'<polygon points="{head}" fill="var(--{colour})"/>'
    )


def turn(x: float, y: float, radius: float, ends: tuple[float, float], colour: str) -> str:
    """A part of a circle with a head at its end: a torque.

    Args:
        x: Of the middle [pixels].
        y: Of the middle [pixels].
        radius: [pixels].
        ends: Where it begins and ends, from the right towards the top [degrees].
        colour: Its name.
    """
    first, last = (math.radians(angle) for angle in ends)
    points = [(x + radius * math.cos(a), y - radius * math.sin(a)) for a in (first, last)]
    (x0, y0), (x1, y1) = points
    back = last - math.copysign(0.25, last - first)
    before = (x + radius * math.cos(back), y - radius * math.sin(back))
    sweep = 0 if last > first else 1
    large = 1 if abs(last - first) > math.pi else 0
    return (
        f'<path d="M {x0:.1f} {y0:.1f} A {radius:g} {radius:g} 0 {large} {sweep} {before[0]:.1f} '
        f'{before[1]:.1f}" fill="none" stroke="var(--{colour})" stroke-width="3"/>'
        + arrow(*before, x1, y1, colour)
    )


def table(
    y: float, title: str, columns: Sequence[str], rows: Mapping[str, Sequence[str]], wide: float
) -> list[str]:
    """Words in rows and columns.

    Args:
        y: Of its first line [pixels].
        title: Above it.
        columns: Their names.
        rows: Words, by the row's name.
        wide: Of a column [pixels].
    """
    places = [LEFT + wide * (k + 0.5) for k in range(len(columns))]
    parts = [words(8, y, title, "start", "font-weight: 600")]
    parts += [words(x, y + 26, name, "middle") for x, name in zip(places, columns, strict=True)]
    for k, (name, cells) in enumerate(rows.items()):
        level = y + 26 + CELL * (k + 1)
        parts.append(line((8, level - 20, LEFT + wide * len(columns), level - 20), "line", 1))
        parts.append(words(8, level, name))
        parts += [words(x, level, cell, "middle") for x, cell in zip(places, cells, strict=True)]
    return parts


def error_dots(
    errors: Mapping[str, Mapping[str, float]], label: Mapping[str, str], left: float = LEFT
) -> tuple[float, float, list[str]]:
    """Errors of parameters as dots on one logarithmic scale.

    Args:
        errors: In percent, by parameter, by method.
        label: What the methods are called.
        left: Room for the names [pixels].

    Returns:
        Width and height [pixels], and the elements.
    """
    shown = [abs(e) for row in errors.values() for e in row.values() if e and math.isfinite(e)]
    low = math.floor(math.log10(max(min(shown), 1e-14)))
    high = max(math.ceil(math.log10(max(shown))), low + 1)
    step = max(1, math.ceil((high - low) / 5))

    def at(error: float) -> float:
        share = (math.log10(max(abs(error), 10.0**low)) - low) / (high - low)
        return left + share * LONG

    top, bottom = 40, 40 + ROW * len(errors) + 6
    parts = []
    for k, (method, said) in enumerate(label.items()):
        x = left + 190 * k
        parts += [dot(x + 6, 16, 5.5, method), words(x + 18, 21, said)]
    for power in range(low, high + 1, step):
        x = at(10.0**power)
        label = f"{10.0**power:g} %" if power >= -4 else f"1e{power} %"
        parts.append(line((x, top - 4, x, bottom), "line", 1))
        parts.append(words(x, bottom + 18, label, "middle", "font-size: 12px", "faint"))
    for k, (name, row) in enumerate(errors.items()):
        y = top + ROW * (k + 0.5)
        parts.append(words(left - 14, y + 5, name, "end"))
        found = [at(e) for e in row.values()]
        parts.append(line((min(found), y, max(found), y), "line", 2))
        parts += [dot(at(error), y, 5.5, method) for method, error in row.items()]
    return left + LONG + 40, bottom + 28, parts
