"""The command line: parses, calls, prints.

Exit codes: 0 done and as expected; 1 done, but a claim of [expect] failed; 2 the input is
at fault, with one message on standard error; 70 a fault of this program; 130 interrupted;
141 nobody reads the output any more.
"""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from types import FrameType
from typing import TextIO

RESERVE = 1_000_000
"""Bytes that are kept back for saying that there is no more memory."""

YOUNG = 100_000
"""Objects between two collections of cycles: imports alone make a million, and leave few."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a command: by Ctrl-C, by another process, by a terminal that is closed."""

INPUT_AT_FAULT, OUR_FAULT, INTERRUPTED, UNREAD = 2, 70, 130, 141


def main() -> None:
    """Run a command; what the user got wrong is one line and exit code 2.

    What is heavy is imported by `_command`, so that Ctrl-C is answered from the first moment.
    """
    interrupts, reserve = _Interrupts(), bytearray(RESERVE)
    gc.set_threshold(YOUNG)
    try:
        try:
            _ready_streams()
            code = _command()
        except BaseException as error:
            del reserve
            code = INTERRUPTED if interrupts.seen else _told(error)
        interrupts.default()
    except KeyboardInterrupt:  # between an error and its message
        code = INTERRUPTED
    if code == INTERRUPTED:
        _say("interrupted")
    code = _flushed(code)
    interrupts.ignore()
    gc.freeze()  # the process ends: to look for cycles in all that was imported takes .3 s
    sys.exit(code)


class _Interrupts:
    """The first Ctrl-C is an exception and the work is tidied up; the next one ends at once.

    So are the signals by which a system or a closing terminal ends a process.
    An import that is interrupted may raise any other exception instead: `seen` says. Where
    Python swallows an exception, in callbacks of its own, it is raised again a moment later.
    """

    def __init__(self) -> None:
        self.seen = False
        # else ignored, as under nohup
        usual = (
            signal.default_int_handler,
            signal.SIG_DFL,
        )
        self._caught = [each for each in ENDING if signal.getsignal(each) in usual]
        for each in self._caught:
            signal.signal(each, self._interrupt)
        sys.unraisablehook = self._swallowed

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        self.default()
        raise KeyboardInterrupt

    def _swallowed(self, what: sys.UnraisableHookArgs) -> None:
        """Python has caught an exception that nobody can catch."""
        if (
            self.seen
            and what.exc_type is KeyboardInterrupt
            and hasattr(signal, "setitimer")
        ):
            signal.signal(signal.SIGALRM, self._interrupt)
            signal.setitimer(signal.ITIMER_REAL, 0.01)
        else:
            sys.__unraisablehook__(what)

    def ignore(self) -> None:
        """Everything is done and said: Ctrl-C no longer matters."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def default(self) -> None:
        """From now on a signal ends the process without a word."""
        for each in self._caught:
            if signal.getsignal(each) == self._interrupt:
                signal.signal(each, signal.SIG_DFL)


def _ready_streams() -> None:
    """Streams that are there even if whoever started us closed them; output takes any text."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        # in this order each takes its own file descriptor
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        # names in letters a terminal lacks
        sys.stdout.reconfigure(errors="backslashreplace")


def _command() -> int:
    """Carry out what the command line asks for; its exit code."""
    import warnings

    from testbed.cli.commands import app
    from testbed.cli.options import joined_vectors
    from testbed.core.base.cache import cache_folder
    from testbed.core.base.files import guarded

    warnings.simplefilter("ignore")  # numerical doubt is a field of the result
    # no command renders: else MuJoCo would start another Python to try a library of windows
    os.environ.setdefault("MUJOCO_GL", "disable")
    # else Matplotlib keeps its list of fonts elsewhere in the home folder
    os.environ.setdefault("MPLCONFIGDIR", str(cache_folder() / "matplotlib"))
    try:
        with guarded():
            code = app(joined_vectors(sys.argv[1:]), standalone_mode=False)
    except SystemExit:  # the option parser's answer to a broken pipe
        return UNREAD
    sys.stdout.flush()
    return code if isinstance(code, int) else 0


def _told(error: BaseException) -> int:
    """Say what an error means, in one line; the exit code."""
    from testbed.core.base.errors import TestbedError

    code, message = INPUT_AT_FAULT, str(error)
    match error:
        case TestbedError():
            pass
        case BrokenPipeError():
            return UNREAD
        case OSError():  # a full disk, a folder that may not be written
            name = error.filename2 or error.filename  # of a copy, where it goes to
            place = f"'{name}': " if name is not None else ""
            message = f"{place}{error.strerror}" if error.strerror else message
        case MemoryError():
            message = "not enough memory; ask for less, such as a shorter motion"
        case RecursionError():
            message = "the input is nested too deeply"
        case UnicodeDecodeError():
            fault = f"{error.reason} at byte {error.start}"
            message = f"a file that should be text is not UTF-8: {fault}"
        case ImportError():  # an installation that is broken, or no memory for it
            code, message = OUR_FAULT, f"a library cannot be loaded: {error}"
        case _ if hasattr(error, "format_message"):  # of the option parser
            context = getattr(error, "ctx", None)
            command = (
                f" {context.info_name}"
                if context is not None and context.parent
                else ""
            )
            # none where it has printed the help instead
            message = error.format_message()
            message = message and f"{message} (see testbed{command} --help)"
        case _:
            import traceback

            traceback.print_exception(error)
            code, message = (
                OUR_FAULT,
                "the above is a fault of the program; please report it",
            )
    if message:
        _say(message)
    return code


def _say(message: str) -> None:
    """One line on standard error."""
    from testbed.core.base.errors import printable

    try:
        sys.stderr.write(f"testbed: {printable(message)}\n")
        sys.stderr.flush()
    except OSError:  # nobody reads any more
        _give_up(sys.stderr)


def _flushed(code: int) -> int:
    """The exit code, once nothing is left to write: the interpreter's own words are many."""
    try:
        sys.stdout.flush()
    except OSError:
        _give_up(sys.stdout)
    return code


def _give_up(stream: TextIO) -> None:
    """What still waits to be written goes nowhere; the interpreter would try again at the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
