"""Calls in a child Python: what they give back, and what ends with the child alone."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testbed.core.base.child_process import ChildResult, call_in_child
from testbed.core.base.errors import ModelError, RecordingError

GB = 1_000_000_000


def echo(said: Any) -> ChildResult:
    return said, {"a/\udc80": np.arange(3), "": np.ones((2, 2))}


def crash(_file: str) -> ChildResult:
    return ctypes.string_at(0), {}


def loop(_file: str) -> ChildResult:
    while True:
        pass


def hoard(_file: str) -> ChildResult:
    return None, {"a": np.ones(10**10)}


def flood(file: str) -> ChildResult:
    with Path(file).open("wb") as stream:
        stream.truncate(3 * GB)
    return None, {}


def refuse(file: str) -> ChildResult:
    raise RecordingError(f"{file}: no")


def fail(file: str) -> ChildResult:
    raise KeyError(file)


def objects(_file: str) -> ChildResult:
    return None, {"a": np.array([print], dtype=object)}


def call(function: Any, argument: Any = "log.x", **limits: Any) -> Any:
    name = f"{__name__}:{function.__name__}"
    return call_in_child(name, argument, file=Path("log.x"), error=ModelError, **limits)


def test_json_and_arrays_come_back_as_they_were() -> None:
    given = {"a": [1, None, "\u202e\udc80", 1e-320]}
    said, arrays = call(echo, given)
    assert said == given
    for name, array in echo(None)[1].items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


@pytest.mark.parametrize("function", [crash, hoard, refuse, fail, objects])
def test_what_befalls_the_child_is_one_error_that_names_the_file(function: Any) -> None:
    with pytest.raises(ModelError, match=r"^log\.x: ") as caught:
        call(function, memory=2 * GB)
    assert len(str(caught.value)) < 300


def test_files_of_a_child_have_the_size_of_its_memory(tmp_path: Path) -> None:
    with pytest.raises(ModelError):
        call(flood, str(tmp_path / "flood"), memory=2 * GB)
    assert (tmp_path / "flood").stat().st_size == 0


def test_a_loop_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    began = time.monotonic()
    with pytest.raises(ModelError):
        call(loop, seconds=1.0)
    assert time.monotonic() - began < 10


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_child_and_its_folder_end_with_the_parent(number: int, tmp_path: Path) -> None:
    command = f"import {__name__} as t; t.call(t.loop, seconds=100)"
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", command], env=environment, stderr=-3)
    own = f"testbed.core.base.child_process {tmp_path}".replace(" ", "\0").encode()

    def running() -> bool:
        found = Path("/proc").glob("[0-9]*/cmdline")
        return any(own in each.read_bytes() for each in found if each.exists())

    def wait_until(wanted: bool) -> None:
        last = time.monotonic() + 10
        while running() is not wanted:
            assert time.monotonic() < last
            time.sleep(0.02)

    wait_until(True)
    time.sleep(0.5)
    parent.send_signal(number)
    parent.wait(10)
    wait_until(False)
    assert not [*tmp_path.iterdir()]
