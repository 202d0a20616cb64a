"""Calls of this program's functions in a child Python, within limits of time and memory.

Libraries in C crash, loop or fill the memory on a damaged file; with them only the child ends.
What comes back are JSON and NumPy arrays in a temporary folder, never pickles.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.errors import TestbedError

SECONDS, BYTES = 60.0, 4_000_000_000
"""Wall time and address space of a child."""

Returned = tuple[Any, Mapping[str, NDArray[Any]]]
"""JSON, and arrays by name: what functions return that are called in a child."""


def call_in_child(
    function: str,
    *arguments: Any,
    file: Path,
    error: type[TestbedError],
    seconds: float = SECONDS,
    memory: int = BYTES,
) -> Returned:
    """Call a function in a child process, which also ends when this process ends.

    Args:
        function: MODULE:NAME of a function that returns `Returned`; a literal of this program.
        arguments: JSON.
        file: What it reads, as errors name it.
        error: Class of the errors raised here, which takes a message.
        seconds: Wall time.
        memory: Bytes of address space, and of each file written; held where the system can.

    Raises:
        TestbedError: An `error`, in the words of the function's own, or saying that the library
            crashed, failed, or went beyond the limits.
    """
    with tempfile.TemporaryDirectory(
        prefix="testbed-", ignore_cleanup_errors=True
    ) as name:
        folder = Path(name)
        (folder / "call.json").write_text(
            json.dumps([function, arguments, seconds, memory])
        )
        code = _ended(folder, seconds)
        if code is None:
            raise error(
                f"{file}: reading took more than {seconds:.0f} s: the file is damaged or too "
                "large; write it again, smaller or in another format"
            )
        if code:
            raise error(
                f"{file}: the library that reads it crashed ({code}): the file is damaged; fetch "
                "or write it again, or convert it to another format"
            )
        answer = json.loads((folder / "answer.json").read_text())
        if "refused" in answer:
            raise error(answer["refused"])
        arrays = (np.load(folder / f"{k}.npy") for k in range(len(answer["names"])))
        return answer["said"], dict(zip(answer["names"], arrays, strict=True))


def _ended(folder: Path, seconds: float) -> int | None:
    """Exit code of a child Python that makes the call in a folder; None where it took too long."""
    process = subprocess.Popen(
        # -P: no code of the working folder
        [
            sys.executable,
            "-P",
            "-m",
            __name__,
            str(folder),
        ],
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        return None
    finally:  # after Ctrl-C, too
        if process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(
                    process.pid, signal.SIGKILL
                ) if os.name == "posix" else process.kill()
        process.communicate()


def _make_call(folder: Path) -> None:
    """Make the call that a folder holds, in the child, and write its answer there."""
    function, arguments, seconds, memory = json.loads(
        (folder / "call.json").read_text()
    )
    file = str(arguments[0]) if arguments else function
    _limit(seconds, memory)
    threading.Thread(target=_follow_parent, args=(folder,), daemon=True).start()
    tempfile.tempdir = str(folder)  # removed with it whatever happens
    module, _, name = function.partition(":")
    try:
        said, arrays = getattr(import_module(module), name)(*arguments)
        for k, array in enumerate(arrays.values()):
            np.save(folder / f"{k}.npy", array, allow_pickle=False)
        answer = {"said": said, "names": [*arrays]}
    except TestbedError as error:
        answer = {"refused": str(error)}
    except MemoryError:
        answer = {
            "refused": f"{file}: reading takes more than {memory / 1e9:.1f} GB of memory: the file "
            "is damaged or too large; write it again, smaller or in parts"
        }
    except Exception as error:  # libraries raise whatever a damaged file makes them
        said = " ".join(str(error).split())
        answer = {"refused": f"{file}: not readable: {said} ({type(error).__name__})"}
    (folder / "answer.json").write_text(json.dumps(answer))
    os._exit(0)  # a library may still crash as it is unloaded


def _limit(seconds: float, memory: int) -> None:
    """Limits of this process, where the system has such."""
    with suppress(ImportError):
        import resource  # not on Windows

        limits = {
            resource.RLIMIT_AS: memory,
            resource.RLIMIT_FSIZE: memory,
            # of all threads; where no parent ends it
            resource.RLIMIT_CPU: int(10 * seconds),
            resource.RLIMIT_CORE: 0,
        }
        for which, most in limits.items():
            with suppress(ValueError, OSError):  # a limit from outside is lower
                resource.setrlimit(which, (most, resource.getrlimit(which)[1]))


def _follow_parent(folder: Path) -> None:
    """End this process when the parent ends and so closes its end of the pipe."""
    sys.stdin.buffer.read()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    _make_call(Path(sys.argv[1]))
