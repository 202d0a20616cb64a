"""One hostile input: files in a folder, and a command that is to take or refuse them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


def write_files(folder: Path, files: Mapping[str, bytes], links: Mapping[str, str]) -> None:
    """Write files, symbolic links and pipes into a folder.

    Args:
        folder: Where to.
        files: Content by name.
        links: Targets by name; a pipe where there is none.
    """
    for name in (*files, *links):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    for name, target in links.items():
        (folder / name).symlink_to(target) if target else os.mkfifo(folder / name)


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
