"""What people see, held against a copy that a person has looked at.

`TESTBED_APPROVE=1 pytest ...` writes the copies anew; the difference is for git to show and
for a person to look at.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from itertools import zip_longest

from tests.helpers.paths import ROOT

APPROVED = ROOT / "tests/approved"

_NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")

SAME = 1e-3
"""Relative difference of numbers that libraries may make: signals have noise, sigmas have not."""

DUST = 1e-8
"""Numbers below this are rounding, which is another on other machines."""

COUNTED = 1000
"""Whole numbers up to this are counts, and exact."""


FEW = 20
"""Points of a line up to this are counted."""


def hold(name: str, text: str, within: float = SAME) -> None:
    """Say where a text differs from its approved copy: in any word, or in a number by much.

    Args:
        name: Of the copy below tests/approved.
        text: What is shown now.
        within: Relative difference of numbers that is none.
    """
    place = APPROVED / name
    if "TESTBED_APPROVE" in os.environ:
        place.write_text(text, encoding="utf-8")
    wanted = place.read_text(encoding="utf-8").splitlines()
    for line, (was, now) in enumerate(zip_longest(wanted, text.splitlines()), 1):
        assert same(was, now, within), (
            f"{place.name}, line {line}:\n  approved: {was}\n  now:      {now}"
        )


def same(was: str | None, now: str | None, within: float = SAME) -> bool:
    """Whether two lines say the same, numbers within what their last digit and noise allow."""
    if was is None or now is None:
        return False
    if was == now:
        return True
    alike = _NUMBER.sub("#", was) == _NUMBER.sub("#", now) or _spaced(was) == _spaced(now)
    return alike and all(
        _near(a, b, within) for a, b in zip(_NUMBER.findall(was), _NUMBER.findall(now), strict=True)
    )


def _spaced(line: str) -> str:
    """A line with its numbers blotted out, those in a column with the spaces before them."""
    return re.sub(rf" +{_NUMBER.pattern}", lambda found: "#" * len(found[0]), line)


def _near(was: str, now: str, within: float) -> bool:
    if was == now:
        return True
    a, b = float(was), float(now)
    if max(abs(a), abs(b)) < DUST:
        return True
    if re.fullmatch(r"[+-]?\d+", was) and max(abs(a), abs(b)) <= COUNTED:
        return False
    last = 10.0 ** -len(was.lower().partition("e")[0].partition(".")[2])
    scale = 10.0 ** int(was.lower().partition("e")[2] or 0)
    rounding = min(1.01 * last * scale, 0.2 * abs(a))  # of one digit alone none is forgiven
    return abs(a - b) <= rounding + within * abs(a)


def timeless(text: str) -> str:
    """Without what each machine, moment or release of a library has its own of.

    When a clearance is least is one of them: a body that only turns is as near all the time.
    """
    text = re.sub(r"about \S+ (seconds|minutes|hours)", "about TIME", text)
    text = re.sub(r"\b(python|testbed|mujoco|numpy|scipy|pin) \d[\w.+]*", r"\1 VERSION", text)
    row = r"(clearance of [^\n]*\n(?:[^\n]*\n){0,4}?[^\n]*at t \[s\]\">)[\d.]+"
    text = re.sub(row, r"\1TIME", text)
    text = re.sub(r'("instant": )[\d.]+(,\n *"label": "clearance of )', r"\1TIME\2", text)
    text = re.sub(r"(clearance of [^\n]*?mm (?:left at t = )?\s*)\d+\\*\.\d+", r"\1TIME", text)
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def tags(html: str) -> str:
    """A page, one tag or text a line; of matplotlib's drawings what they say and where.

    What a library adds to lines (clipping, joints, names) is left out.
    """
    html = re.sub(r"(?s)<style.*?</style>|data:[\w/+]*;base64,[^\"]*", "", html)
    html = re.sub(r"(?s)<svg\b[^>]*>(?:(?!</svg>).)*figure_1.*?</svg>", _drawn, html)
    lines = (line.strip() for line in re.sub(r">\s*<", ">\n<", html).splitlines())
    return "\n".join(line for line in lines if line) + "\n"


def _drawn(found: re.Match[str]) -> str:
    """Of a drawing by matplotlib: its size, its words, its lines by colour and width."""
    svg = found[0]
    size, name = _attribute("viewBox", svg), _attribute("aria-label", svg)
    lines = [f"<svg {size}: {name}>"]
    for tag, words in re.findall(r"<text ([^>]*)>([^<]*)<", svg):
        kept = [part for part in _attribute("style", tag).split("; ") if "family" not in part]
        turn, x, y = map(float, re.findall(r"-?[\d.]+", _attribute("transform", tag)))
        lines.append(f"<text {'; '.join(kept)}; {turn + 0.0:.0f}> {words} at {x:.1f} {y:.1f}")
    points: dict[str, list[str]] = defaultdict(list)
    for tag in re.findall(r"<path ([^>]*)>", svg):
        style = re.sub(r"; stroke-line(cap|join): \w+", "", _attribute("style", tag))
        points[style] += re.findall(r"[ML] (\S+ \S+)", _attribute("d", tag))
    for style, along in points.items():
        across, down = (sorted(float(point.split()[k]) for point in along) for k in (0, 1))
        ends = [f"{each[0]:.1f} to {each[-1]:.1f}" for each in (across, down) if each]
        count = len(along) if len(along) <= FEW else "many"  # a library leaves some out
        lines.append(f"<path {style}> {count} points, {', '.join(ends)}")
    return "\n".join([*lines, "</svg>"])


def _attribute(name: str, tag: str) -> str:
    found = re.search(rf'\b{name}="([^"]*)"', tag)
    return found[1] if found else ""
