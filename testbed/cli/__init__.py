"""The command line: parses, calls, prints.

Exit codes: 0 done and as expected; 1 done, but a claim of [expect] failed; 2 the input is
at fault, with one message on standard error.
"""

from __future__ import annotations

import sys
import warnings
from typing import NoReturn

import typer

from testbed.cli import experiments, models, pictures
from testbed.cli.options import app
from testbed.errors import TestbedError

__all__ = ["app", "experiments", "main", "models", "pictures"]


def main() -> None:
    """Run a command; what the user got wrong is one line and exit code 2."""
    warnings.simplefilter("ignore")  # numerical doubt is a field of the result
    try:
        code = app(standalone_mode=False)
    except TestbedError as error:
        _fail(str(error))
    except OSError as error:  # a full disk, a folder that may not be written
        _fail(str(error))
    except MemoryError:
        _fail("not enough memory; make the run shorter")
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write("testbed: interrupted\n")
        sys.exit(130)
    except Exception as error:
        message = getattr(error, "format_message", None)  # what the option parser found
        if message is None:
            raise
        _fail(f"{message()} (testbed --help tells more)")
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> NoReturn:
    sys.stderr.write(f"testbed: {' '.join(message.split())}\n")
    sys.exit(2)
