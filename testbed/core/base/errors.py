"""Exceptions caused by user input, and functions for the wording of their messages.

All errors that a user can cause derive from `TestbedError`. The command line prints the message on
one line and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from itertools import accumulate, islice
from pathlib import Path

MAX_MESSAGE_LENGTH = 500
"""Largest number of characters of a message, so that it fits into a terminal.

Most messages have at most 300 characters. Longer messages quote lines of a mapping file or list the
joints of a loop.
"""
MAX_SEARCHED_LENGTH = 200
"""Largest length of a name for which similar names are sought, because the search is slow."""
VALUES_PER_UNKNOWN = 3
"""Recommended number of measured values per unknown, for a motion without repetitions."""
MAX_LISTED, MAX_LIST_WIDTH = 6, 100
"""Largest number of names and largest width [characters] of a list in a message."""
MAX_SUGGESTIONS, MAX_SEARCHED_NAMES = 5, 2000
"""Largest number of suggested names, and of known names among which suggestions are sought."""


def printable_line(text: str, limit: int = MAX_MESSAGE_LENGTH) -> str:
    r"""Text as a single line of printable characters, shortened in the middle.

    Args:
        text: Any text, such as a name or a message of a file.
        limit: Largest number of characters of the result.

    Returns:
        Text with single spaces in place of white space and line ends; control characters (escape
        sequences, C1 controls, bidirectional marks) are replaced by codes such as \x1b.
    """
    characters = [
        escape_control_characters(letter) for letter in " ".join(text.split())
    ]
    count = sum(map(len, characters))
    if count <= limit:
        return "".join(characters)
    gap = f" ... ({count} characters in all) ... "
    gap = gap if 2 * len(gap) < limit else "..."
    room = limit - len(gap)
    return (
        _leading_pieces(characters, room - room // 2)
        + gap
        + _leading_pieces(characters[::-1], room // 2, backwards=True)
    )


def escape_control_characters(text: str) -> str:
    r"""Replace control characters, except tab and line feed, by codes such as \x1b."""
    return "".join(
        c
        if c.isprintable() or c in "\n\t\u00a0"
        else c.encode("unicode_escape").decode()
        for c in text
    )


def round_significant(value: float, digits: int) -> float:
    """Round a number to a given number of significant digits.

    Args:
        value: Any number.
        digits: Number of significant digits, at least 1.
    """
    return float(f"{value:.{digits}g}")


def count_with_noun(count: int, noun: str) -> str:
    """Count followed by the noun in singular or plural: "1 sample", "2 samples"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def shortened_list(
    names: Sequence[str], width: int | None = None, by: str = ", "
) -> str:
    """First names of a list as text, with the number of omitted names.

    Args:
        names: Names, for example of parameters.
        width: Largest total number of characters of the names; the first name is never shortened.
            By default, the limit is `MAX_LISTED` names of any length.
        by: Separator between the names.
    """
    ends = accumulate((len(name) + len(by) for name in names), initial=0)
    count = MAX_LISTED if width is None else sum(end <= width for end in ends) - 1
    listed = names[: max(count, 1)]
    more = f" and {len(names) - len(listed)} more" if len(names) > len(listed) else ""
    return by.join(listed) + more


def quoted_list(names: Iterable[str]) -> str:
    """First names of a list in quotes, with the number of omitted names."""
    return shortened_list([f"'{name}'" for name in names], MAX_LIST_WIDTH)


def vector_text(vector: Iterable[float]) -> str:
    """Components of a vector as text, with four significant digits."""
    return " ".join(f"{value:.4g}" for value in vector)


def _leading_pieces(
    pieces: Sequence[str], limit: int, *, backwards: bool = False
) -> str:
    """Join as many leading pieces of a text as fit into a limit of characters.

    With `backwards`, the pieces are given in reverse order and joined in the order of the text.
    """
    chosen: list[str] = []
    for piece in pieces:
        limit -= len(piece)
        if limit < 0:
            break
        chosen.append(piece)
    return "".join(chosen[::-1] if backwards else chosen)


class TestbedError(Exception):
    """Base class of all errors that a user can cause."""

    __test__ = False  # no test class for pytest


class ModelError(TestbedError):
    """Unreadable model file, or model with unsupported elements."""


class UnknownName(TestbedError):
    """Unknown name; the message suggests similar known names.

    Attributes:
        name: The unknown name.
        known: All known names.
    """

    def __init__(self, what: str, name: str, known: Iterable[str]) -> None:
        self.name = name
        self.known = tuple(known)
        printed_name = printable_line(name, MAX_LIST_WIDTH)
        if same := [each for each in self.known if each.casefold() == name.casefold()]:
            super().__init__(
                f"there is no {what} '{printed_name}'; there is {quoted_list(same)}"
            )
            return
        searchable = [each for each in self.known if len(each) <= MAX_SEARCHED_LENGTH]
        similar = (
            get_close_matches(name, searchable[:MAX_SEARCHED_NAMES], MAX_SUGGESTIONS)
            if len(name) <= MAX_SEARCHED_LENGTH
            else []
        )
        hint = f"; did you mean '{similar[0]}'?" if similar else ""
        listed = shortened_list(
            list(dict.fromkeys([*similar, *searchable])), MAX_LIST_WIDTH
        )
        super().__init__(f"unknown {what} '{printed_name}'{hint} (known: {listed})")


def missing_file_message(path: Path, what: str) -> str:
    """Error message for a path that is not a file.

    If the path exists, the message gives its kind (folder, device). Otherwise, it suggests a
    similar name in the folder.

    Args:
        path: Path as written by the user.
        what: Expected kind of file.
    """
    if path.exists():
        return f"'{path}' is a {'folder' if path.is_dir() else 'device or pipe'}, no {what}"
    try:
        names = [
            each.name for each in islice(path.parent.iterdir(), MAX_SEARCHED_NAMES)
        ]
    except OSError:
        names = []
    similar = get_close_matches(path.name[:MAX_SEARCHED_LENGTH], names, 1)
    hint = f"; did you mean '{path.with_name(similar[0])}'?" if similar else ""
    return f"there is no {what} '{path}'{hint}"


class RecordingError(TestbedError):
    """Error: damaged or incomplete recording, or recording of another robot."""


class SettingsError(TestbedError, ValueError):
    """Invalid settings of signal processing."""


class ExperimentError(TestbedError):
    """Invalid experiment file."""


class NoFeasibleMotion(TestbedError):
    """Error: no motion was found within the robot's limits."""


class UnidentifiableParameters(TestbedError):
    """Error: base parameters that the data cannot distinguish from each other.

    Attributes:
        names: Names of the parameters.
        rank: Rank of the equations.
    """

    def __init__(
        self, names: Sequence[str], rank: int, count: int, samples: int
    ) -> None:
        self.names = tuple(names)
        self.rank = rank
        if 0 < samples < count:
            message = (
                f"{count_with_noun(samples, 'value')}, filtered and of all channels, for {count} "
                "unknowns: record at "
                f"least {count / samples:.1f} times as long, better "
                f"{VALUES_PER_UNKNOWN * count / samples:.0f} "
                "times, and let no motion repeat within that time"
            )
        else:
            message = (
                f"{count_with_noun(samples, 'sample')} determine only {rank} of {count} unknowns: "
                f"{shortened_list(self.names, MAX_LIST_WIDTH)} are collinear; record a longer or "
                "richer motion of the joints concerned"
                + ", or leave terms out (--terms)"
                * any("/" in name for name in self.names)
            )
        super().__init__(message)


class ExpressionError(TestbedError):
    """Error: expression too long, or of too high a degree, to be expanded."""


class ViewerError(TestbedError):
    """Failure to open the viewer."""
