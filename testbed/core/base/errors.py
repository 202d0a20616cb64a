"""Errors for the person: what was asked, what was found, what to do.

Every error that a user can cause derives from `TestbedError`; the data ride along as
attributes. The command line prints the message as one line and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from itertools import accumulate, islice
from pathlib import Path

LONGEST_MESSAGE = 500
"""Characters of a message; more would drive everything else off the terminal.

Messages have 300 at most, but where they print lines for a mapping or list a loop's joints."""
LONGEST_NAME = 200
"""Names longer than this are not searched for likely typing errors: that takes too long."""
ENOUGH = 3
"""Values for each unknown that are enough of a motion that does not repeat."""
LISTED, WIDTH = 6, 100
"""Names that a line lists of many, and characters that an error's may have together."""
NEAR, SEARCHED = 5, 2000
"""Likely meant names that come first in a list, and names that are searched for them."""


def printable(text: str, limit: int = LONGEST_MESSAGE) -> str:
    r"""Text as one line that any terminal shows as it is.

    Args:
        text: Any, also from a file: names, messages.
        limit: Characters of the result; text that is longer loses its middle, and says so.

    Returns:
        Blanks and line ends of every kind as single spaces; what a terminal would obey and not
        show (escape sequences, C1 controls, bidirectional marks) spelled out, as \x1b.
    """
    shown = [visible(letter) for letter in " ".join(text.split())]
    count = sum(map(len, shown))
    if count <= limit:
        return "".join(shown)
    gap = f" ... ({count} characters in all) ... "
    gap = gap if 2 * len(gap) < limit else "..."
    left = limit - len(gap)
    return (
        _start(shown, left - left // 2)
        + gap
        + _start(shown[::-1], left // 2, backwards=True)
    )


def visible(text: str) -> str:
    r"""Text of any lines, with what a terminal would obey spelled out: \x1b, \u202e, \r."""
    return "".join(
        c
        if c.isprintable() or c in "\n\t\u00a0"
        else c.encode("unicode_escape").decode()
        for c in text
    )


def round_significant(value: float, digits: int) -> float:
    """A number with so many significant digits, as a person writes it.

    Args:
        value: Any.
        digits: At least one.
    """
    return float(f"{value:.{digits}g}")


def plural(count: int, noun: str) -> str:
    """A number with its noun: "1 sample", "2 samples"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def few(names: Sequence[str], width: int | None = None, by: str = ", ") -> str:
    """The first names of a list, and how many there are more.

    Args:
        names: Of parameters, for example.
        width: Characters that they may have together, the first being whole; default: `LISTED`
            names, whatever their length.
        by: What stands between them.
    """
    ends = accumulate((len(name) + len(by) for name in names), initial=0)
    fit = LISTED if width is None else sum(end <= width for end in ends) - 1
    shown = names[: max(fit, 1)]
    more = f" and {len(names) - len(shown)} more" if len(names) > len(shown) else ""
    return by.join(shown) + more


def quoted(names: Iterable[str]) -> str:
    """The first names of a list, each in quotes, and how many there are more."""
    return few([f"'{name}'" for name in names], WIDTH)


def components(vector: Iterable[float]) -> str:
    """A vector as a person reads it."""
    return " ".join(f"{value:.4g}" for value in vector)


def _start(pieces: Sequence[str], limit: int, *, backwards: bool = False) -> str:
    """As many whole pieces as there is place for."""
    taken: list[str] = []
    for piece in pieces:
        limit -= len(piece)
        if limit < 0:
            break
        taken.append(piece)
    return "".join(taken[::-1] if backwards else taken)


class TestbedError(Exception):
    """Base of all errors that speak to the user."""

    __test__ = False  # not a test class, whatever its name


class ModelError(TestbedError):
    """A model file cannot be read, or holds something this project does not support."""


class UnknownName(TestbedError):
    """A name that is not one of those known; `name` and `known` are kept."""

    def __init__(self, what: str, name: str, known: Iterable[str]) -> None:
        self.name = name
        self.known = tuple(known)
        shown = printable(name, WIDTH)
        if same := [each for each in self.known if each.casefold() == name.casefold()]:
            super().__init__(f"there is no {what} '{shown}'; there is {quoted(same)}")
            return
        short = [each for each in self.known if len(each) <= LONGEST_NAME]
        near = (
            get_close_matches(name, short[:SEARCHED], NEAR)
            if len(name) <= LONGEST_NAME
            else []
        )
        hint = f"; did you mean '{near[0]}'?" if near else ""
        listed = few(list(dict.fromkeys([*near, *short])), WIDTH)
        super().__init__(f"unknown {what} '{shown}'{hint} (known: {listed})")


def no_file(path: Path, what: str) -> str:
    """What to say of a file that is none, with the name beside it that may be meant.

    Args:
        path: As a person wrote it.
        what: Of what it should be.
    """
    if path.exists():
        return f"'{path}' is a {'folder' if path.is_dir() else 'device or pipe'}, no {what}"
    try:
        names = [each.name for each in islice(path.parent.iterdir(), SEARCHED)]
    except OSError:
        names = []
    near = get_close_matches(path.name[:LONGEST_NAME], names, 1)
    hint = f"; did you mean '{path.with_name(near[0])}'?" if near else ""
    return f"there is no {what} '{path}'{hint}"


class RecordingError(TestbedError):
    """A recording that is damaged, incomplete, or of another robot."""


class SettingsError(TestbedError, ValueError):
    """A treatment of the signals that would spoil them."""


class ExperimentError(TestbedError):
    """An experiment file that cannot be carried out as written."""


class InfeasibleMotion(TestbedError):
    """No motion within the robot's limits could be found."""


class UnseenParameters(TestbedError):
    """The data cannot distinguish some base parameters; `names` lists them."""

    def __init__(
        self, names: Sequence[str], rank: int, count: int, samples: int
    ) -> None:
        self.names = tuple(names)
        self.rank = rank
        if 0 < samples < count:
            said = (
                f"{plural(samples, 'value')}, filtered and of all channels, for {count} "
                "unknowns: record at "
                f"least {count / samples:.1f} times as long, better {ENOUGH * count / samples:.0f} "
                "times, and let no motion repeat within that time"
            )
        else:
            said = (
                f"{plural(samples, 'sample')} determine only {rank} of {count} unknowns: "
                f"{few(self.names, WIDTH)} are collinear; record a longer or richer motion of "
                "the joints concerned"
                + ", or leave terms out (--terms)"
                * any("/" in name for name in self.names)
            )
        super().__init__(said)


class ExpressionError(TestbedError):
    """An expression that is too long, or of too high a degree, to be multiplied out."""


class ViewerError(TestbedError):
    """The viewer cannot be opened."""
