"""One hostile input: files in a folder, and a command that is to take or refuse them."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Case:
    """One hostile input.

    Attributes:
        words: The command line, in the case's folder.
        files: What lies there, by name.
        outputs: What the command may leave there.
        links: What symbolic links there point to, by name; a pipe where that is nothing.
        named: What a refusal must name.
    """

    words: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict, repr=False)
    outputs: tuple[str, ...] = ()
    links: dict[str, str] = field(default_factory=dict)
    named: tuple[str, ...] = ()
