"""A simulation shown in an open viewer while it runs."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

import numpy as np
import rerun as rr

from testbed.bodies.shapes.appearance import Appearance
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ViewerError
from testbed.core.recordings.columns import AXES
from testbed.core.recordings.recording import Truth
from testbed.view.viewer.blueprint import live_blueprint
from testbed.view.viewer.colours import COLOURS, palette
from testbed.view.viewer.curves import send_values
from testbed.view.viewer.robot_drawing import (
    ARROW,
    log_appearance,
    send_arrows,
    send_poses,
)
from testbed.view.viewer.scene import POSES, safe

LOOPBACK = "127.0.0.1"
QUIET = {"CI": "1"}
"""Environment in which Rerun's programs send and keep no usage statistics; they have no other
switch that leaves the home folder as it is."""


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
    command = [program, str(path), "--bind", LOOPBACK]
    subprocess.Popen(command, env=_environment(), start_new_session=True)


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
        raise ViewerError(
            "the command 'rerun' is not there; pip install rerun-sdk brings it"
        )
    sys.stdout.flush()
    os.execve(program, command, _environment())


def _environment() -> dict[str, str]:
    """This process's, with Rerun's usage statistics off."""
    return {k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"} | QUIET


def viewer_program() -> str | None:
    """The command 'rerun' of this Python, else the one that the shell would find."""
    beside = Path(sys.executable).parent / "rerun"
    return str(beside) if beside.is_file() else shutil.which("rerun")


def has_screen() -> bool:
    """Whether there is a screen to open a window on; elsewhere than on Linux there is."""
    linux = sys.platform.startswith("linux")
    return not linux or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


PATIENCE = 5.0
"""How long a viewer may take to answer [s]."""
PORT = 9876
"""Where `rerun --bind 127.0.0.1` listens."""


class Live:
    """Sends what happens to a viewer; to be called with every second of it."""

    def __init__(self, name: str, look: Appearance, port: int = PORT) -> None:
        """Connect to a viewer on this machine, and show the robot.

        Args:
            name: Of the run.
            look: The robot and what it looks like.
            port: Of the viewer.

        Raises:
            ViewerError: No viewer listens there.
        """
        try:
            socket.create_connection((LOOPBACK, port), 1.0).close()
        except OSError:
            raise ViewerError(
                f"no viewer listens at {LOOPBACK}:{port}; open one first with "
                f"rerun --bind {LOOPBACK}"
            ) from None
        self._look = look
        self._stream = rr.RecordingStream("testbed", send_properties=False)
        self._stream.connect_grpc(
            f"rerun+http://{LOOPBACK}:{port}/proxy",
            default_blueprint=live_blueprint(name, look.tree, look.reach),
        )
        log_appearance(self._stream, look, "/world")
        names = look.tree.names
        lines = rr.SeriesLines(names=names, colors=palette(len(names)))
        self._stream.log("/position", lines, static=True)
        self._paths = [
            *(f"/wrench/{c}" for c in AXES),
            *(f"/torque/{safe(n)}" for n in names),
        ]
        single = rr.SeriesLines(names=["true"], colors=[COLOURS["measured"]])
        for path in self._paths:
            self._stream.log(path, single, static=True)
        mass = max(sum(inertia.mass for inertia in look.tree.inertias), 1e-3)
        weight = mass * max(float(np.linalg.norm(look.tree.gravity)), 1.0)
        self._scales = ARROW / weight * np.array([look.reach / 1.5, 1 / 0.3])
        self._flush()

    def __call__(self, time: Array, truth: Truth) -> None:
        """Show a part of the run.

        Args:
            time: (M,) [s]; below zero before the recording.
            truth: What happened.
        """
        there = time >= 0
        if not there.any():
            return
        time, q, wrench = time[there], truth.position[there], truth.wrench[there]
        _, frames = np.unique(np.floor(POSES * time), return_index=True)
        send_poses(self._stream, self._look, time[frames], q[frames], "/world")
        send_arrows(
            self._stream,
            self._look,
            time[frames],
            wrench[frames],
            self._scales,
            "/world/bedplate",
        )
        send_values(self._stream, "/position", time, q)
        signals = np.hstack([wrench, truth.torque[there]])
        for path, values in zip(self._paths, signals.T, strict=True):
            send_values(self._stream, path, time, values)
        self._flush()

    def _flush(self) -> None:
        """Wait until the viewer has it, but not for ever."""
        try:
            self._stream.flush(timeout_sec=PATIENCE)
        except Exception:  # Rerun raises errors of its own
            raise ViewerError(
                f"what listens at {LOOPBACK} does not take the run; is it Rerun's viewer, and open?"
            ) from None
