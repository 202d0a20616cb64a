"""Entry point of the command line: error messages, exit codes and interrupts.

Exit codes: 0 success; 1 finished, but an expectation of [expect] failed; 2 error in the input,
with one message on standard error; 70 error of this program; 130 interrupted; 141 closed output
pipe.
"""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from types import FrameType
from typing import TextIO

RESERVED_BYTES = 1_000_000
"""Memory reserved for the message of a MemoryError [bytes]."""

COLLECTION_THRESHOLD = 100_000
"""Allocations between garbage collections: imports allocate a million objects, few cyclic."""

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a command: Ctrl-C, termination, closed terminal."""

INPUT_ERROR, PROGRAM_ERROR, INTERRUPTED, BROKEN_PIPE = 2, 70, 130, 141


def main() -> None:
    """Run the command given on the command line, and exit with its exit code.

    Any exception is converted to a message on standard error and an exit code (see the module
    docstring). Slow modules are imported in `_command`, so that Ctrl-C is handled from the start.
    """
    interrupts, reserve = _Interrupts(), bytearray(RESERVED_BYTES)
    gc.set_threshold(COLLECTION_THRESHOLD)
    try:
        try:
            _prepare_streams()
            code = _command()
        except BaseException as error:
            del reserve
            code = INTERRUPTED if interrupts.interrupted else _print_error(error)
        interrupts.restore_defaults()
    except KeyboardInterrupt:  # between an error and its message
        code = INTERRUPTED
    if code == INTERRUPTED:
        _print_line("interrupted")
    code = _flush_output(code)
    interrupts.ignore_interrupts()
    gc.freeze()  # avoids a garbage collection of .3 s at exit
    sys.exit(code)


class _Interrupts:
    """Signal handlers for Ctrl-C: the first raises KeyboardInterrupt, the second ends the process.

    SIGTERM and SIGHUP are treated as Ctrl-C; signals that the parent process ignores remain
    ignored. An import that is interrupted may raise a different exception, so `interrupted` is set
    to True by any of these signals. If Python discards the KeyboardInterrupt, as in a callback, it
    is raised again after 10 ms.
    """

    def __init__(self) -> None:
        self.interrupted = False
        # other handlers stay, such as ignored signals under nohup
        default_handlers = (
            signal.default_int_handler,
            signal.SIG_DFL,
        )
        self._handled_signals = [
            each
            for each in ENDING_SIGNALS
            if signal.getsignal(each) in default_handlers
        ]
        for each in self._handled_signals:
            signal.signal(each, self._interrupt)
        sys.unraisablehook = self._repeat_interrupt

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """Handle the first signal: restore the default handlers and raise KeyboardInterrupt."""
        self.interrupted = True
        self.restore_defaults()
        raise KeyboardInterrupt

    def _repeat_interrupt(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Raise a KeyboardInterrupt that Python has discarded again, after 10 ms.

        For other exceptions, and on platforms without timers, Python's default hook is called.
        """
        if (
            self.interrupted
            and unraisable.exc_type is KeyboardInterrupt
            and hasattr(signal, "setitimer")
        ):
            signal.signal(signal.SIGALRM, self._interrupt)
            signal.setitimer(signal.ITIMER_REAL, 0.01)
        else:
            sys.__unraisablehook__(unraisable)

    def ignore_interrupts(self) -> None:
        """Ignore Ctrl-C from now on; called when all output has been written."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def restore_defaults(self) -> None:
        """Restore the default signal handlers, which end the process without a message."""
        for each in self._handled_signals:
            if signal.getsignal(each) == self._interrupt:
                signal.signal(each, signal.SIG_DFL)


def _prepare_streams() -> None:
    """Replace closed standard streams by the null device, and set error handling for encoding.

    Characters that the encoding of standard output lacks are written as backslash escapes.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        # in this order each stream gets its standard file descriptor
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        # for characters that the terminal cannot encode
        sys.stdout.reconfigure(errors="backslashreplace")


def _command() -> int:
    """Run the command given on the command line, and return its exit code.

    The warning filter, and environment variables for MuJoCo and Matplotlib, are set first. Errors
    of the command are raised.
    """
    import warnings

    from testbed.cli.commands import app
    from testbed.cli.options import join_gravity_words
    from testbed.core.base.cache import cache_folder
    from testbed.core.base.files import refuse_changed_targets

    warnings.simplefilter("ignore")  # numerical warnings are fields of the results
    # no command renders; otherwise MuJoCo starts a Python process to test a window library
    os.environ.setdefault("MUJOCO_GL", "disable")
    # otherwise Matplotlib writes its font cache elsewhere in the home folder
    os.environ.setdefault("MPLCONFIGDIR", str(cache_folder() / "matplotlib"))
    try:
        with refuse_changed_targets():
            code = app(join_gravity_words(sys.argv[1:]), standalone_mode=False)
    except SystemExit:  # raised by the option parser for a broken pipe
        return BROKEN_PIPE
    sys.stdout.flush()
    return code if isinstance(code, int) else 0


def _print_error(error: BaseException) -> int:
    """Print the message of an error on one line, and return the exit code.

    The code is 2 for `TestbedError` and for errors of the operating system, memory, nesting depth,
    encoding and options. It is 70 for a library that cannot be loaded and, with a traceback, for
    other exceptions. It is 141, without a message, for a closed pipe.
    """
    from testbed.core.base.errors import TestbedError

    code, message = INPUT_ERROR, str(error)
    match error:
        case TestbedError():
            pass
        case BrokenPipeError():
            return BROKEN_PIPE
        case OSError():  # a full disk, a folder that may not be written
            name = error.filename2 or error.filename  # for a copy the target
            path_text = f"'{name}': " if name is not None else ""
            message = f"{path_text}{error.strerror}" if error.strerror else message
        case MemoryError():
            message = "not enough memory; ask for less, such as a shorter motion"
        case RecursionError():
            message = "the input is nested too deeply"
        case UnicodeDecodeError():
            reason = f"{error.reason} at byte {error.start}"
            message = f"a file that should be text is not UTF-8: {reason}"
        case ImportError():  # broken installation, or too little memory
            code, message = PROGRAM_ERROR, f"a library cannot be loaded: {error}"
        case _ if hasattr(error, "format_message"):  # error of the option parser
            context = getattr(error, "ctx", None)
            command = (
                f" {context.info_name}"
                if context is not None and context.parent
                else ""
            )
            # empty if the help was printed instead
            message = error.format_message()
            message = message and f"{message} (see testbed{command} --help)"
        case _:
            import traceback

            traceback.print_exception(error)
            code, message = (
                PROGRAM_ERROR,
                "the above is a fault of the program; please report it",
            )
    if message:
        _print_line(message)
    return code


def _print_line(message: str) -> None:
    """Print one line on standard error with the prefix "testbed: ", ignoring a closed pipe."""
    from testbed.core.base.errors import printable_line

    try:
        sys.stderr.write(f"testbed: {printable_line(message)}\n")
        sys.stderr.flush()
    except OSError:  # the pipe is closed
        _discard_output(sys.stderr)


def _flush_output(code: int) -> int:
    """Flush standard output, and return the exit code.

    After an OSError, for example due to a closed pipe, remaining output is discarded and the given
    code is returned.
    """
    try:
        sys.stdout.flush()
    except OSError:
        _discard_output(sys.stdout)
    return code


def _discard_output(stream: TextIO) -> None:
    """Redirect a stream to the null device, so that the flush at exit cannot fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
