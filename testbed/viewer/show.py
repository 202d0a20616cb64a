"""Open Rerun's viewer on a file, or serve it to a browser on this machine only."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

from testbed.errors import ViewerError

LOOPBACK = "127.0.0.1"


def open_viewer(path: Path) -> NoReturn:
    """Become Rerun's viewer, showing a file.

    Args:
        path: The .rrd file.

    Raises:
        ViewerError: There is no viewer, or no screen for it.
    """
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise ViewerError(
            f"there is no screen to open the viewer on; it is all in '{path}': "
            "open that elsewhere, or show it in a browser with --serve"
        )
    _become(["rerun", str(path), "--bind", LOOPBACK])


def serve(path: Path, port: int) -> NoReturn:
    """Serve a file to a browser on this machine, until interrupted.

    Args:
        path: The .rrd file.
        port: Of the web page.
    """
    web = ["--serve-web", "--web-viewer-port", str(port), "--bind", LOOPBACK]
    _become(["rerun", str(path), *web])


def _become(command: list[str]) -> NoReturn:
    beside = Path(sys.executable).parent / "rerun"
    program = str(beside) if beside.is_file() else shutil.which("rerun")
    if program is None:
        raise ViewerError("the command 'rerun' is not there; pip install rerun-sdk brings it")
    sys.stdout.flush()
    os.execv(program, command)
