"""Function calls in a child Python process with limits of time and memory.

On a damaged file, C libraries may crash, loop endlessly or exhaust the memory. In a child process,
such a failure does not affect this process. Results are passed as JSON and NumPy arrays in a
temporary folder, never as pickles.
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

MAX_SECONDS, MAX_BYTES = 60.0, 4_000_000_000
"""Default limits of a child process: run time [s] and address space [bytes]."""

ChildResult = tuple[Any, Mapping[str, NDArray[Any]]]
"""Return value of functions called in a child: JSON content, and arrays keyed by name."""


def call_in_child(
    function: str,
    *arguments: Any,
    file: Path,
    error: type[TestbedError],
    seconds: float = MAX_SECONDS,
    memory: int = MAX_BYTES,
) -> ChildResult:
    """Call a function in a child process, with limits of time and memory.

    The child process is killed at the time limit; it ends when this process ends.

    Args:
        function: Function of this package in the form MODULE:NAME, given as a literal. It returns a
            `ChildResult`: JSON content, and arrays keyed by name.
        *arguments: Arguments of the function, as JSON values.
        file: File that the function reads, for error messages.
        error: Class of the errors to raise; its constructor takes a message.
        seconds: Limit of run time [s].
        memory: Limit of address space and of the size of each written file [bytes], on systems that
            support such limits.

    Returns:
        Return value of the function.

    Raises:
        TestbedError: An instance of `error` with the message of the function's error, or with the
            message that the library crashed, failed, or exceeded the limits.
    """
    with tempfile.TemporaryDirectory(
        prefix="testbed-", ignore_cleanup_errors=True
    ) as name:
        folder = Path(name)
        (folder / "call.json").write_text(
            json.dumps([function, arguments, seconds, memory])
        )
        code = _run_child(folder, seconds)
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


def _run_child(folder: Path, seconds: float) -> int | None:
    """Run the call in `call.json` of a folder in a child; return its exit code.

    The result is None if the child exceeds the time limit and is killed.
    """
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
    """Run the call in `call.json` of a folder, and write its results there.

    This function runs in the child process, which then ends with exit code 0. Array number k is
    written to k.npy. The file `answer.json` contains the JSON content and the array names, or the
    message of any error raised by the function.
    """
    function, arguments, seconds, memory = json.loads(
        (folder / "call.json").read_text()
    )
    file = str(arguments[0]) if arguments else function
    _limit_resources(seconds, memory)
    threading.Thread(target=_exit_with_parent, args=(folder,), daemon=True).start()
    tempfile.tempdir = str(folder)  # removed with the folder in all cases
    module, _, name = function.partition(":")
    try:
        content, arrays = getattr(import_module(module), name)(*arguments)
        for k, array in enumerate(arrays.values()):
            np.save(folder / f"{k}.npy", array, allow_pickle=False)
        answer = {"said": content, "names": [*arrays]}
    except TestbedError as error:
        answer = {"refused": str(error)}
    except MemoryError:
        answer = {
            "refused": f"{file}: reading takes more than {memory / 1e9:.1f} GB of memory: the file "
            "is damaged or too large; write it again, smaller or in parts"
        }
    except Exception as error:  # a damaged file may raise any error in a library
        text = " ".join(str(error).split())
        answer = {"refused": f"{file}: not readable: {text} ({type(error).__name__})"}
    (folder / "answer.json").write_text(json.dumps(answer))
    os._exit(0)  # a library may still crash as it is unloaded


def _limit_resources(seconds: float, memory: int) -> None:
    """Limit memory, file size and CPU time of this process, if the system supports limits."""
    with suppress(ImportError):
        import resource  # not on Windows

        limits = {
            resource.RLIMIT_AS: memory,
            resource.RLIMIT_FSIZE: memory,
            # CPU time of all threads, in case the parent does not end the child
            resource.RLIMIT_CPU: int(10 * seconds),
            resource.RLIMIT_CORE: 0,
        }
        for resource_id, limit in limits.items():
            with suppress(ValueError, OSError):  # an inherited limit is lower
                resource.setrlimit(
                    resource_id, (limit, resource.getrlimit(resource_id)[1])
                )


def _exit_with_parent(folder: Path) -> None:
    """End this process when the parent ends and thereby closes the pipe.

    The folder of the call is removed first.
    """
    sys.stdin.buffer.read()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    _make_call(Path(sys.argv[1]))
