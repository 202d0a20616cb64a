"""Figures as SVG that takes its colours from the page: text stays text, nothing is fetched."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from testbed.core.base.arrays import Array

KINDS = ("measured", "unexplained", "external", "internal")
"""What curves may be; later ones are drawn over earlier ones."""
WIDTH, HEIGHT = 295.2, 133.2
"""Of a plot [points]."""
LEFT, RIGHT, BOTTOM, TOP = 34.0, 13.0, 32.4, 14.4
"""Around its axes [points]."""
MOST_LEFT = 0.6
"""Of the width, for labels."""
LOWER = 49.0
"""Height of axes that stand below others [points]."""
ROW = 13.7
"""Height of a named row [points]."""
TICK, GAP = 3.5, 3.5
"""Length of a tick, and from there to its label [points]."""
MOST_TICKS, BETWEEN_TICKS = 6, 34.0
"""Of a horizontal axis, and from one to the next at least [points]."""
FONT, MIDDLE, NUMBERS, X_LABEL = 9.0, 3.2, 13.8, 27.0
"""Size of letters; from their middle, and from the horizontal axis, to their feet [points]."""
WIDTHS = ("iIjlftr.,:;|!'()[]/ ·-⁻⁰¹²³⁴⁵⁶⁷⁸⁹", 0.42), ("mwMWOQDGHNU@%&<>+=−~^_$#", 0.95)
"""Letters that take less room than others, and more; of the size, in wide fonts."""
LETTER = 0.67
"""Width of all others."""
THIN, THICKER = 1.0, 1.2
"""Width of the line on top, and by how much each one below is wider: it is seen on both sides."""
BROAD = 2.6
"""Width of pale bars."""
DOT, SMALL, CORNERS = 4.5, 2.0, 6.4
"""Size of points, of many points, and of those with corners."""
FEW = 200
"""Points of a curve, more than which are small."""
GRID, PALE = ' opacity=".35"', ' opacity=".28"'

MOST_ROWS = 9
"""Named rows from which they stand in several plots."""
COLUMNS = 3
"""Plots beside each other on a wide page."""
APART = 0.32
"""Of points in one row, in rows."""
LEAST_ROOM = 5e-3
"""Beside values that are nearly equal, part of their size."""

STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Between ticks, in powers of ten."""
STILL = 1e-12
"""Part of its size by which a value must change to be drawn as changing."""
ROOM = 0.05
"""Around a value that does not change, part of its size."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Curves = Mapping[str, tuple[Array, Array]]  # x and y by what they are: measured, external, ...


@dataclass(frozen=True, eq=False)
class Panel:
    """One small plot, or several below each other over one horizontal axis.

    Attributes:
        title: What it shows, with unit.
        curves: By what they are: "measured", "external", "internal" or "unexplained".
        x_label: With unit.
        log: Both axes logarithmic; of named rows the horizontal one.
        points: Which curves are drawn as points.
        bars: Ends of the bars of points in named rows, by curve.
        pale: Bars are broad and pale, as those that begin at the axis.
        bands: Half the width of the band around a line, by curve.
        names: Of the rows 0, 1, ... from above, where points stand in such.
        room: For labels at least, as plots beside this one need it [points].
        limits: Of the horizontal axis; None for what the curves need.
        from_zero: The vertical axis begins at zero.
        below: Curves of further plots, by their titles.
    """

    title: str
    curves: Curves
    x_label: str
    log: bool = False
    points: tuple[str, ...] = ()
    bars: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    pale: bool = False
    bands: Mapping[str, Array] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    room: float = 0.0
    limits: tuple[float, float] | None = None
    from_zero: bool = False
    below: Mapping[str, Curves] = field(default_factory=dict)

    @property
    def says(self) -> str:
        """What it shows, for those who do not see it."""
        rows = [f"{self.names[0]} to {self.names[-1]}"] if self.names else []
        shown = [words for words in (self.title, *rows, *self.below) if words]
        return f"{', '.join(shown)} over {self.x_label}"

    @property
    def svg(self) -> str:
        """The plot as an element of a page."""
        every = {self.title: self.curves, **self.below}
        across = self._across(every.values())
        upright = [self._upright(curves, across.log) for curves in every.values()]
        labels = [label for scale in upright for label in self._labels(scale).values()]
        room = max(self.room, *map(text_width, labels)) + TICK + 2 * GAP
        left = min(max(LEFT, room), MOST_LEFT * WIDTH)
        height = ROW * len(self.names) if self.names else HEIGHT - TOP - BOTTOM
        parts, bottom = [], 0.0
        for (title, curves), scale in zip(every.items(), upright, strict=True):
            top = bottom + (TOP if title else GAP)
            bottom = top + height
            frame = Frame(left, WIDTH - RIGHT, top, bottom, across, scale)
            parts += [text(title, left, top - GAP, "start"), *self._axes(frame)]
            parts += self._drawn(frame, curves)
            height = LOWER
        parts += [
            text(across.label(tick), x, bottom + NUMBERS, "middle", "x")
            for tick, x in zip(frame.ticks.tolist(), frame.across(frame.ticks), strict=True)
        ]
        parts.append(text(self.x_label, (left + WIDTH - RIGHT) / 2, bottom + X_LABEL, "middle"))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {bottom + BOTTOM:.1f}"'
            f' role="img" aria-label="{escape(self.says)}" fill="none" font-size="{FONT:g}" '
            f"font-family=\"'DejaVu Sans',sans-serif\">{''.join(parts)}</svg>"
        )

    def _across(self, every: Iterable[Curves]) -> Scale:
        """The horizontal axis, which all plots share; even where no logarithm can be shown."""
        values = [each for curves in every for each in curves.values()]
        log = self.log and (bool(self.names) or any((y > 0).any() for _, y in values))
        if self.limits is not None:
            return Scale(*self.limits, log)
        ends = [end for pair in self.bars.values() for end in pair]
        return Scale.of(np.concatenate([*(x for x, _ in values), *ends]), 0.02, log)

    def _upright(self, curves: Curves, log: bool) -> Scale:
        """The vertical axis of one plot."""
        if self.names:
            return Scale(len(self.names) - 0.5, -0.5)
        values = [y for _, y in curves.values()]
        if log:
            return Scale.of(np.concatenate(values), 0.0, log).decades
        for kind, wide in self.bands.items():
            values += [curves[kind][1] - wide, curves[kind][1] + wide]
        scale = Scale.of(np.concatenate(values), 0.05)
        return Scale(0.0, scale.high) if self.from_zero else scale

    def _labels(self, scale: Scale) -> dict[float, str]:
        """What is written beside a vertical axis, by value."""
        if self.names:
            return dict(enumerate(self.names))
        return {tick: scale.label(tick) for tick in scale.ticks(2 if self.below else 4).tolist()}

    def _axes(self, frame: Frame) -> Iterator[str]:
        """Grid, axes and ticks of one plot, and the labels of its vertical axis."""
        labels = self._labels(frame.y)
        heights = frame.up(np.array([*labels], dtype=float)).tolist()
        at, rows = frame.across(frame.ticks).tolist(), [] if self.names else heights
        left, right, top, bottom = frame.left, frame.right, frame.top, frame.bottom
        grid = [f"M{x:.1f},{bottom:.1f}V{top:.1f}" for x in at]
        grid += [f"M{left:.1f},{y:.1f}H{right:.1f}" for y in rows]
        yield stroke("".join(grid), "faint", 0.8, GRID)
        yield stroke(f"M{left:.1f},{top:.1f}V{bottom:.1f}H{right:.1f}", "faint", 0.8)
        marks = [f"M{x:.1f},{bottom:.1f}v{TICK}" for x in at]
        minor = frame.across(frame.x.minor(frame.ticks)).tolist()
        marks += [f"M{x:.1f},{bottom:.1f}v{TICK / 2}" for x in minor]
        marks += [f"M{left:.1f},{y:.1f}h{-TICK}" for y in rows]
        minor = frame.up(frame.y.minor(np.array([*labels]))).tolist()
        marks += [f"M{left:.1f},{y:.1f}h{-TICK / 2}" for y in minor]
        yield stroke("".join(marks), "ink", 0.8)
        edge = left - GAP - (0.0 if self.names else TICK)
        for label, y in zip(labels.values(), heights, strict=True):
            yield text(label, edge, y + MIDDLE, "end", "y")

    def _drawn(self, frame: Frame, curves: Curves) -> Iterator[str]:
        """The curves of one plot, and their bars; bands below all."""
        shown = [kind for kind in KINDS if kind in curves]
        lines = [kind for kind in shown if kind not in self.points]
        for kind, wide in self.bands.items():
            x, y = curves[kind]
            for part in pieces(frame.across(x), frame.up(y - wide), frame.up(y + wide)):
                outline = path(np.concatenate([part[:, :2], part[::-1, ::2]]))
                yield f'<path d="{outline}z" fill="{colour(kind)}" opacity=".3"/>'
        for kind in shown:
            x, y = frame.across(curves[kind][0]), frame.up(curves[kind][1])
            if kind in self.bars:
                ends = pieces(*map(frame.across, self.bars[kind]), y)
                bars = (f"M{a:.1f},{at:.1f}H{b:.1f}" for part in ends for a, b, at in part.tolist())
                yield stroke("".join(bars), kind, BROAD if self.pale else THIN, PALE * self.pale)
            if kind in lines:
                width = THIN + THICKER * (len(lines) - 1 - lines.index(kind))
                yield stroke("".join(map(path, pieces(x, y))), kind, width)
            else:
                yield dots(np.column_stack([x, y]), kind)


@dataclass(frozen=True, eq=False)
class Frame:
    """Where one plot stands, and its axes.

    Attributes:
        left: Edge [points].
        right: Edge [points].
        top: Edge, downwards from the figure's [points].
        bottom: Edge [points].
        x: The horizontal axis.
        y: The vertical one.
    """

    left: float
    right: float
    top: float
    bottom: float
    x: Scale
    y: Scale

    @property
    def ticks(self) -> Array:
        """Of the horizontal axis: as many as there is room for their labels."""
        return self.x.ticks(min(MOST_TICKS, int((self.right - self.left) / BETWEEN_TICKS)))

    def across(self, values: Array) -> Array:
        """From the figure's left to values [points]."""
        return self.left + (self.right - self.left) * self.x.part(values)

    def up(self, values: Array) -> Array:
        """From the figure's top down to values [points]."""
        return self.bottom - (self.bottom - self.top) * self.y.part(values)


def pieces(*columns: Array) -> Iterator[Array]:
    """Rows side by side, in pieces of which all are numbers, (M, columns)."""
    rows = np.column_stack(columns)
    there = np.isfinite(rows).all(axis=1)
    for part in np.split(rows, np.flatnonzero(~there)):
        part = part[1:] if len(part) and not np.isfinite(part[0]).all() else part
        if len(part):
            yield part


def path(points: Array) -> str:
    """A line through points, (M, 2)."""
    return "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())


def stroke(line: str, kind: str, width: float, more: str = "") -> str:
    """A line as an element."""
    return (
        f'<path d="{line}" stroke="{colour(kind)}" stroke-width="{width:g}" '
        f'stroke-linejoin="round"{more}/>'
    )


def dots(points: Array, kind: str) -> str:
    """Points as an element, (M, 2); those of joint torques have corners."""
    there = points[np.isfinite(points).all(axis=1)].tolist()
    if kind == "internal":
        half = CORNERS / 2
        turns = f"l{half},{half} {-half},{half} {-half},{-half}z"
        marks = "".join(f"M{x:.1f},{y - half:.1f}{turns}" for x, y in there)
        return f'<path d="{marks}" fill="{colour(kind)}"/>'
    size = SMALL if len(points) > FEW else DOT
    marks = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in there)
    return stroke(marks, kind, size, ' stroke-linecap="round"')


def text(words: str, x: float, y: float, anchor: str, axis: str = "") -> str:
    """Words as an element; of a tick, which axis has it."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="var(--ink)"'
        f"{f' class={axis!r}' if axis else ''}>{escape(words)}</text>"
    )


def text_width(words: str) -> float:
    """Of a line, more than less [points]."""
    known = {letter: width for letters, width in WIDTHS for letter in letters}
    return FONT * sum(known.get(letter, LETTER) for letter in words)


def colour(kind: str) -> str:
    """As the page has it."""
    return f"var(--{'measured' if kind == 'unexplained' else kind})"


def thinned(x: Array, y: Array, most: int = 1500) -> tuple[Array, Array]:
    """At most so many points of a curve, evenly taken."""
    step = max(1, -(-len(x) // most))
    return x[::step], y[::step]


def named_panels(
    title: str,
    names: Sequence[str],
    values: Mapping[str, Array],
    x_label: str,
    *,
    bars: Mapping[str, tuple[Array, Array]] | None = None,
    pale: bool = False,
    line: float | None = None,
    log: bool = False,
) -> list[Panel]:
    """Values by name, a row each; many in several plots on one scale.

    Args:
        title: What is shown.
        names: (p,).
        values: By what they are, (p,).
        x_label: Of the values, with unit.
        bars: Ends of bars, by what they are of, (p,) each.
        pale: Bars are broad and pale, as those that begin at the axis.
        line: What the values are held against.
        log: Logarithmic; values that are no numbers above zero are not drawn.
    """
    bars = bars or {}
    every = np.concatenate([*values.values(), *(end for pair in bars.values() for end in pair)])
    every = np.append(every, [] if line is None else line)
    every = every[np.isfinite(every) & ((every > 0) | (not log))]
    low, high = (float(every.min()), float(every.max())) if every.size else (0.1, 1.0)
    if log:
        low, high = 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high))
        limits = (low, max(high, 10 * low))
    else:
        room = max(0.04 * (high - low), LEAST_ROOM * max(abs(low), abs(high))) or 1.0
        limits = (low - room, high + room)
    panels = []
    count = COLUMNS if len(names) > MOST_ROWS else 1
    for part in np.array_split(np.arange(len(names)), count):
        rows = np.arange(len(part), dtype=float)
        curves = {
            kind: (each[part], rows + APART * (k - (len(values) - 1) / 2))
            for k, (kind, each) in enumerate(values.items())
        }
        if line is not None:
            curves["measured"] = np.array([line, line]), np.array([-0.5, len(part) - 0.5])
        panels.append(
            Panel(
                title,
                curves,
                x_label,
                log=log,
                points=tuple(values),
                bars={kind: (low[part], high[part]) for kind, (low, high) in bars.items()},
                pale=pale,
                names=tuple(names[k] for k in part),
                room=max(map(text_width, names)),
                limits=limits,
            )
        )
    return panels


@dataclass(frozen=True)
class Scale:
    """One axis.

    Attributes:
        low: Value where it begins; may be above `high`.
        high: Value where it ends.
        log: Logarithmic: both are above zero.
    """

    low: float
    high: float
    log: bool = False

    @classmethod
    def of(cls, values: Array, room: float, log: bool = False) -> Scale:
        """The axis that values need.

        Args:
            values: Some of them perhaps not numbers, or without a logarithm.
            room: On either side, part of the axis that the values fill.
            log: Logarithmic.
        """
        there = values[np.isfinite(values) & ((values > 0) | (not log))]
        low, high = (float(there.min()), float(there.max())) if there.size else (1.0, 10.0)
        if log:
            low, high = np.log10([low, high]).tolist()
        size = max(abs(low), abs(high))
        if high - low <= STILL * size:
            low, high = low - ROOM * (size or 1.0), high + ROOM * (size or 1.0)
        low, high = low - room * (high - low), high + room * (high - low)
        return cls(10.0**low, 10.0**high, log) if log else cls(low, high)

    @property
    def decades(self) -> Scale:
        """The same of a logarithmic axis from one power of ten to another."""
        low, high = (f(np.log10(end)) for f, end in ((np.floor, self.low), (np.ceil, self.high)))
        return Scale(10.0**low, 10.0 ** max(high, low + 1), True)

    def part(self, values: Array) -> Array:
        """How far along the axis values stand, 0 to 1; nan for what has no place."""
        low, high = self.low, self.high
        if self.log:
            values = np.log10(np.where(values > 0, values, np.nan))
            low, high = np.log10([low, high]).tolist()
        return np.asarray((values - low) / (high - low))

    def ticks(self, most: int) -> Array:
        """Round values: two or more, and about `most`; on a logarithmic axis, powers of ten."""
        if self.log:
            ends = np.log10([self.low, self.high])
            powers = np.arange(np.ceil(ends[0] - STILL), np.floor(ends[1] + STILL) + 1)
            return np.asarray(10.0 ** powers[:: len(powers) // (most + 1) + 1])
        wanted = (self.high - self.low) / most
        steps = 10.0 ** np.floor(np.log10(wanted)) * np.array(STEPS)
        first, last = np.ceil(self.low / steps), np.floor(self.high / steps)
        enough = last > first
        chosen = int(np.argmax(enough & (steps >= wanted * (1 - STILL))))  # 0 where there is none
        if chosen == 0:
            chosen = int(np.flatnonzero(enough)[-1])
        numbers = np.arange(first[chosen], last[chosen] + 1) + 0.0  # no zero with a sign
        return np.asarray(steps[chosen] * numbers[:: 1 + (len(numbers) > most + 1)])

    def minor(self, ticks: Array) -> Array:
        """Values between a logarithmic axis' ticks that are marked: none where it skips powers."""
        if not self.log or len(ticks) < 2 or ticks[1] > 10.1 * ticks[0]:
            return np.zeros(0)
        every = np.outer([ticks[0] / 10, *ticks], np.arange(2, 10)).ravel()
        return every[(every >= self.low) & (every <= self.high)]

    def label(self, tick: float) -> str:
        """What is written at a tick."""
        return power_of_ten(tick) if self.log else tick_label(tick)


def tick_label(value: float) -> str:
    """A tick of an even axis: 0.02, -150, and 2·10⁻⁵ where zeros would be counted."""
    number, _, power = f"{value:g}".partition("e")
    if power:
        number += f"·10{str(int(power)).translate(_SUPERSCRIPTS)}"
    return number.replace("-", "−")


def power_of_ten(value: float) -> str:
    """A tick of a logarithmic axis: 0.01, 1, 100, and 10⁻⁵ where zeros would be counted."""
    power = round(float(np.log10(value)))
    if -3 <= power <= 3:
        return f"{10.0**power:g}"
    return f"10{str(power).translate(_SUPERSCRIPTS)}"
