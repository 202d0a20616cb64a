"""Programs of the Rerun viewer, and live display of a running simulation."""

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
from testbed.core.recordings.columns import WRENCH_COMPONENTS
from testbed.core.recordings.recording import Truth
from testbed.view.viewer.blueprint import live_blueprint
from testbed.view.viewer.colours import COLOURS, palette
from testbed.view.viewer.curves import send_values
from testbed.view.viewer.robot_drawing import (
    MAX_ARROW_SHARE,
    log_appearance,
    send_arrows,
    send_poses,
)
from testbed.view.viewer.scene import POSE_RATE, escaped_path_part

LOOPBACK = "127.0.0.1"
"""Address of this computer."""
NO_STATISTICS = {"CI": "1"}
"""Environment that switches off Rerun's usage statistics; other switches change the home folder."""


def become_viewer(path: Path) -> NoReturn:
    """Replace this process by the Rerun viewer, which opens a file.

    Args:
        path: The .rrd file.

    Raises:
        ViewerError: The viewer is not installed, or there is no screen.
    """
    if not has_screen():
        raise ViewerError(
            f"there is no screen to open the viewer on; it is all in '{path}': "
            "open that elsewhere, or show it in a browser with --serve"
        )
    _replace_process(["rerun", str(path), "--bind", LOOPBACK])


def start_viewer(path: Path) -> None:
    """Start the Rerun viewer as a separate process that opens a file.

    Args:
        path: The .rrd file.

    Raises:
        ViewerError: The viewer is not installed, or there is no screen.
    """
    program = viewer_program()
    if program is None or not has_screen():
        raise ViewerError(
            f"there is no {'screen' if program else 'viewer'} to show it; it is all in '{path}'"
        )
    command = [program, str(path), "--bind", LOOPBACK]
    subprocess.Popen(command, env=_environment(), start_new_session=True)


def serve_viewer(path: Path, port: int) -> NoReturn:
    """Replace this process by a local web server with a file in the Rerun viewer.

    Args:
        path: The .rrd file.
        port: Port of the web page.

    Raises:
        ViewerError: The program 'rerun' is not installed.
    """
    web = ["--serve-web", "--web-viewer-port", str(port), "--bind", LOOPBACK]
    _replace_process(["rerun", str(path), *web])


def _replace_process(command: list[str]) -> NoReturn:
    """Replace this process by the program 'rerun'.

    Args:
        command: Name and arguments of the program.

    Raises:
        ViewerError: The program is not installed.
    """
    program = viewer_program()
    if program is None:
        raise ViewerError(
            "the command 'rerun' is not there; pip install rerun-sdk brings it"
        )
    sys.stdout.flush()
    os.execve(program, command, _environment())


def _environment() -> dict[str, str]:
    """Environment variables of this process, with Rerun's usage statistics switched off."""
    return {
        k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"
    } | NO_STATISTICS


def viewer_program() -> str | None:
    """Path of the program 'rerun'; None if it is not installed.

    The program installed with this Python takes precedence over a program on the search path.
    """
    program = Path(sys.executable).parent / "rerun"
    return str(program) if program.is_file() else shutil.which("rerun")


def has_screen() -> bool:
    """Test whether windows can be opened.

    On Linux, this requires a display in the environment.
    """
    linux = sys.platform.startswith("linux")
    return not linux or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


FLUSH_TIMEOUT = 5.0
"""Longest time for the viewer to receive data [s]."""
DEFAULT_PORT = 9876
"""Port of a viewer started by `rerun --bind 127.0.0.1`."""


class LiveViewer:
    """Callback that sends the states of a running simulation to an open Rerun viewer.

    The simulation calls it with consecutive blocks of samples. Poses and arrows are sent at
    `POSE_RATE`; wrench, torques and positions are sent with all samples.
    """

    def __init__(
        self, name: str, appearance: Appearance, port: int = DEFAULT_PORT
    ) -> None:
        """Connect to a viewer on this computer, and display the robot.

        The lengths of the arrows are scaled by the robot's weight, for at least 1e-3 kg at 1 m/s^2.

        Args:
            name: Name of the run.
            appearance: Shapes of the robot.
            port: Port of the viewer.

        Raises:
            ViewerError: There is no viewer on the port.
        """
        try:
            socket.create_connection((LOOPBACK, port), 1.0).close()
        except OSError:
            raise ViewerError(
                f"no viewer listens at {LOOPBACK}:{port}; open one first with "
                f"rerun --bind {LOOPBACK}"
            ) from None
        self._appearance = appearance
        self._stream = rr.RecordingStream("testbed", send_properties=False)
        self._stream.connect_grpc(
            f"rerun+http://{LOOPBACK}:{port}/proxy",
            default_blueprint=live_blueprint(name, appearance.tree, appearance.reach),
        )
        log_appearance(self._stream, appearance, "/world")
        names = appearance.tree.names
        lines = rr.SeriesLines(names=names, colors=palette(len(names)))
        self._stream.log("/position", lines, static=True)
        self._paths = [
            *(f"/wrench/{c}" for c in WRENCH_COMPONENTS),
            *(f"/torque/{escaped_path_part(n)}" for n in names),
        ]
        single = rr.SeriesLines(names=["true"], colors=[COLOURS["measured"]])
        for path in self._paths:
            self._stream.log(path, single, static=True)
        mass = max(sum(inertia.mass for inertia in appearance.tree.inertias), 1e-3)
        weight = mass * max(float(np.linalg.norm(appearance.tree.gravity)), 1.0)
        self._scales = (
            MAX_ARROW_SHARE / weight * np.array([appearance.reach / 1.5, 1 / 0.3])
        )
        self._flush()

    def __call__(self, time: Array, truth: Truth) -> None:
        """Send a block of samples of the simulation, and wait for the viewer.

        Args:
            time: Times, (M,) [s]; samples before zero are not sent.
            truth: True positions, wrench and torques at these times.

        Raises:
            ViewerError: The viewer did not receive the data within `FLUSH_TIMEOUT`.
        """
        is_recorded = time >= 0
        if not is_recorded.any():
            return
        time, q, wrench = (
            time[is_recorded],
            truth.position[is_recorded],
            truth.wrench[is_recorded],
        )
        _, pose_samples = np.unique(np.floor(POSE_RATE * time), return_index=True)
        send_poses(
            self._stream,
            self._appearance,
            time[pose_samples],
            q[pose_samples],
            "/world",
        )
        send_arrows(
            self._stream,
            self._appearance,
            time[pose_samples],
            wrench[pose_samples],
            self._scales,
            "/world/bedplate",
        )
        send_values(self._stream, "/position", time, q)
        signals = np.hstack([wrench, truth.torque[is_recorded]])
        for path, values in zip(self._paths, signals.T, strict=True):
            send_values(self._stream, path, time, values)
        self._flush()

    def _flush(self) -> None:
        """Wait until the viewer has received all data.

        Raises:
            ViewerError: The viewer did not receive the data within `FLUSH_TIMEOUT`.
        """
        try:
            self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
        except Exception:  # Rerun raises errors of its own
            raise ViewerError(
                f"what listens at {LOOPBACK} does not take the run; is it Rerun's viewer, and open?"
            ) from None
