"""The command line as a person calls it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

import pytest

from testbed.cli.main import main

CLI = (sys.executable, "-m", "testbed")


def command_line(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, whose libraries are loaded.

    Args:
        words: As typed.
        cwd: Where.
    """
    with TemporaryFile() as out, TemporaryFile() as err:
        streams = _written_to(1, out.fileno()), _written_to(2, err.fileno())
        with _as_if_alone(cwd, words), streams[0], streams[1], pytest.raises(SystemExit) as end:
            main()
        said = []
        for stream in (out, err):
            stream.seek(0)
            said.append(stream.read().decode())
    assert isinstance(end.value.code, int)
    return subprocess.CompletedProcess([*CLI, *words], end.value.code, *said)


@contextmanager
def _as_if_alone(cwd: Path, words: tuple[str, ...]) -> Iterator[None]:
    """What a command changes of its process is as before afterwards."""
    place, argv, hook = Path.cwd(), sys.argv, sys.unraisablehook
    handler = signal.getsignal(signal.SIGINT)
    os.chdir(cwd)
    sys.argv = ["testbed", *words]
    try:
        with warnings.catch_warnings():
            yield
    finally:
        os.chdir(place)
        sys.argv, sys.unraisablehook = argv, hook
        signal.signal(signal.SIGINT, handler)


@contextmanager
def _written_to(number: int, file: int) -> Iterator[None]:
    """A standard stream that goes into a file, of libraries in C, too."""
    name = {1: "stdout", 2: "stderr"}[number]
    before, saved = getattr(sys, name), os.dup(number)
    before.flush()
    os.dup2(file, number)
    stream = os.fdopen(os.dup(number), "w", encoding="utf-8")
    setattr(sys, name, stream)
    try:
        yield
    finally:
        with suppress(OSError):
            stream.close()
        setattr(sys, name, before)
        os.dup2(saved, number)
        os.close(saved)
