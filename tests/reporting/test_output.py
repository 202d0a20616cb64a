"""What says how far something is, by a clock that is turned by hand."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from testbed.reporting import output


class Clock:
    """In place of an event: so many waits go by, each told to somebody, before it is set."""

    def __init__(self, told: list[Any]) -> None:
        self.told, self.over = told, False

    def wait(self, seconds: float) -> bool:
        if self.told:
            self.told.pop(0)(seconds)
        return self.over or not self.told

    def set(self) -> None:
        self.over = True

    def clear(self) -> None:
        self.over = False


def lines(shown: output.Progress, told: list[Any]) -> None:
    """Write lines as the clock goes, in this thread."""
    shown._ended = Clock(told)  # type: ignore[assignment]
    shown._write_lines()


def test_in_a_pipe_a_line_comes_after_every_ten_seconds(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "BETWEEN", 10.0)
    shown = output.Progress("identifying")
    waited: list[float] = []
    told: list[Any] = [waited.append, waited.append]
    told.append(lambda seconds: shown(1, 4))
    told += [lambda seconds: shown.say(2, 4, "searching"), waited.append]
    lines(shown, told)
    assert capsys.readouterr().err.splitlines() == [
        "identifying ...",
        "identifying ...",
        "identifying, 25% ...",
        "searching, 50% ...",
    ]
    assert waited == [10.0] * 3


def test_of_blocks_in_one_another_one_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    outer, inner = output.Progress("outer"), output.Progress("inner")

    def live() -> list[bool]:
        return [each._bar.live.is_started for each in (outer, inner)]

    with outer:
        assert live() == [True, False]
        with inner:
            assert live() == [False, True]
        assert live() == [True, False]
    assert live() == [False, False]


def test_a_thread_writes_while_the_work_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    """However deep in a library it is; nothing is written after the block."""
    shown = output.Progress("deriving")
    clock = Clock([lambda seconds: None, lambda seconds: None])
    shown._ended = clock  # type: ignore[assignment]
    with shown:
        pass
    assert shown._lines is not None
    assert not shown._lines.is_alive()
    assert set(capsys.readouterr().err.splitlines()) <= {"deriving ..."}
