"""Open Rerun's viewer on a file, or serve it to a browser on this machine only."""

from __future__ import annotations

import os
import shutil
import subprocess
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
    if not has_screen():
        raise ViewerError(
            f"there is no screen to open the viewer on; it is all in '{path}': "
            "open that elsewhere, or show it in a browser with --serve"
        )
    _become(["rerun", str(path), "--bind", LOOPBACK])


def start_viewer(path: Path) -> None:
    """Start Rerun's viewer beside this process, showing a file.

    Args:
        path: The .rrd file.

    Raises:
        ViewerError: There is no viewer, or no screen for it.
    """
    program = viewer_program()
    if program is None or not has_screen():
        raise ViewerError(
            f"there is no {'screen' if program else 'viewer'} to show it; it is all in '{path}'"
        )
    subprocess.Popen([program, str(path), "--bind", LOOPBACK], start_new_session=True)


def serve(path: Path, port: int) -> NoReturn:
    """Serve a file to a browser on this machine, until interrupted.

    Args:
        path: The .rrd file.
        port: Of the web page.
    """
    web = ["--serve-web", "--web-viewer-port", str(port), "--bind", LOOPBACK]
    _become(["rerun", str(path), *web])


def _become(command: list[str]) -> NoReturn:
    program = viewer_program()
    if program is None:
        raise ViewerError("the command 'rerun' is not there; pip install rerun-sdk brings it")
    sys.stdout.flush()
    os.execv(program, command)


def viewer_program() -> str | None:
    """The command 'rerun' of this Python, else the one that the shell would find."""
    beside = Path(sys.executable).parent / "rerun"
    return str(beside) if beside.is_file() else shutil.which("rerun")


def has_screen() -> bool:
    """Whether there is a screen to open a window on; elsewhere than on Linux there is."""
    linux = sys.platform.startswith("linux")
    return not linux or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
