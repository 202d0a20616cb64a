"""Contents of a run for the Rerun viewer: motion, predictions, wrench, sizes, notes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import rerun as rr

from testbed.bodies.shapes.appearance import Appearance, load_appearance
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, sentences
from testbed.core.dynamics.newton_euler import Motion, poses
from testbed.lab.experiment.predict import Channel, Predictions, predict
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import claim_verdict, summary
from testbed.view.drives import DRIVES_TITLE, drive_table
from testbed.view.estimates import sensor_error_tables

MIN_PRESSING_SHARE = 0.05
"""Smallest vertical force for a centre of pressure, as a share of the largest force."""
POSE_RATE = 50.0
"""Rate of displayed poses [Hz]."""
INITIAL_DURATION = 10.0
"""Duration of the initial time window [s]."""
RESIDUAL_CUTOFF = 10.0
"""Cutoff of the low-pass on residuals, above the frequencies of motions [Hz]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Content of one run for the viewer.

    Attributes:
        predictions: Measured signals of the run's recording, and predictions from the estimates.
        appearance: Shapes of the robot.
    """

    predictions: Predictions
    appearance: Appearance

    @property
    def run(self) -> Run:
        """Run with the recording and the estimates."""
        return self.predictions.run

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of the run and of the robot's shapes."""
        return (*self.run.diagnostics, *self.appearance.diagnostics)

    @property
    def motion(self) -> Motion:
        """Filtered motion of the recording; the ends lost to filters are excluded."""
        return self.predictions.motion

    @property
    def pose_samples(self) -> slice:
        """Samples of the motion at which poses are displayed, about `POSE_RATE` per second."""
        return slice(
            0, self.motion.samples, max(1, round(self.run.recording.rate / POSE_RATE))
        )

    @cached_property
    def smoothed_predictions(self) -> Predictions:
        """Predictions and measured signals, low-pass filtered at `RESIDUAL_CUTOFF`."""
        return self.predictions.smoothed(RESIDUAL_CUTOFF)

    @cached_property
    def wrench(self) -> Array | None:
        """Measured wrench over the motion, (M, 6) [N, N m]; None if not recorded.

        The force comes first. The wrench of the plate is about the bedplate's origin; that of a
        force sensor is in the sensor's frame.
        """
        channels = self.predictions.channels
        columns = [each.measured for each in channels if each.kind == "wrench"]
        return np.column_stack(columns) if columns else None

    @cached_property
    def max_distance(self) -> float:
        """Largest distance of the robot from the bedplate's origin, at least 0.3 m [m]."""
        return max_distance_from_origin(
            self.appearance, self.motion.q[self.pose_samples]
        )

    @property
    def time_window(self) -> tuple[float, float]:
        """Start and end of the initial time window [s]."""
        time = self.run.recording.time
        return float(time[0]), float(min(time[0] + INITIAL_DURATION, time[-1]))

    @cached_property
    def notes(self) -> str:
        """Markdown notes of a run: summary, claim, tables of drives and sensors, diagnostics."""
        run = self.run
        summary_lines = [line for line in (*summary(run), claim_verdict(run)) if line]
        lines = [
            f"# {escaped_markdown(run.name)}",
            *(escaped_markdown(line) for line in summary_lines),
        ]
        if run.experiment is not None and run.experiment.claim:
            lines.insert(1, f"**Claim.** {escaped_markdown(run.experiment.claim)}")
        if run.drives is not None:
            lines += [f"## {DRIVES_TITLE}", drive_table(run.drives.estimates).markdown]
        for table in sensor_error_tables(run):
            lines += [f"## {table.title}", table.markdown]
        if self.diagnostics:
            lines.append("## Warnings")
            lines.append(
                "\n".join(
                    f"- {escaped_markdown(line)}"
                    for line in sentences(self.diagnostics)
                )
            )
        return "\n\n".join(lines)


def build_scene(run: Run) -> Scene:
    """Build the content of a run for the viewer: predictions and shapes.

    Args:
        run: The run.
    """
    appearance = load_appearance(run.tree, run.model)
    return Scene(predict(run), appearance)


def max_distance_from_origin(appearance: Appearance, q: Array) -> float:
    """Largest distance of a robot from the bedplate's origin, at least 0.3 m [m].

    The origins of the bodies and the tips are considered.

    Args:
        appearance: Shapes of the robot.
        q: Joint positions, (M, n) [rad or m].
    """
    body_poses = poses(appearance.tree, q)
    points_by_body = [X_WB.p_AB_A for X_WB in body_poses]
    points_by_body += [
        body_poses[j].point(tip) for j, tip in appearance.tip_points.items()
    ]
    return max(
        0.3, *(float(np.linalg.norm(points, axis=1).max()) for points in points_by_body)
    )


def run_entity_path(k: int, count: int) -> str:
    """Entity path of the k-th run; "" if there is only one run.

    Args:
        k: Index of the run.
        count: Number of runs.
    """
    return "" if count == 1 else f"/run{k + 1}"


def escaped_path_part(name: str) -> str:
    """Name of a joint or parameter, escaped for use in an entity path."""
    return str(rr.escape_entity_path_part(name))


def entity(parent: str, channel: Channel) -> str:
    """Entity path of a channel's time series.

    Args:
        parent: Entity path under which the channel is placed.
        channel: The channel.
    """
    return f"{parent}/{channel.kind}/{escaped_path_part(channel.name)}"


def escaped_markdown(text: str) -> str:
    """Text with special characters of Markdown escaped, such as asterisks in names."""
    return re.sub(r"([\\`*_{}\[\]()#+.!<>|~-])", r"\\\1", text)


def pressure(wrench: Array) -> Array:
    """Centre of pressure in the bedplate's plane z = 0, (M, 2) [m].

    It is nan where Fz is below the fraction `MIN_PRESSING_SHARE` of the largest force component
    over time.

    Args:
        wrench: Wrench of the bedplate on the robot, about the bedplate's origin, (M, 6) [N, N m].
    """
    fz = wrench[:, 2]
    is_pressed = fz > MIN_PRESSING_SHARE * np.abs(wrench[:, :3]).max(initial=1e-9)
    pressing_force = np.where(is_pressed, fz, np.nan)
    return np.column_stack(
        [-wrench[:, 4] / pressing_force, wrench[:, 3] / pressing_force]
    )


def block_means(signal: Array, size: int) -> Array:
    """Means of a signal over consecutive blocks of samples, (blocks, k).

    Args:
        signal: Signal, (M, k).
        size: Number of samples of a block; the last block may be shorter.
    """
    blocks = -(-len(signal) // size)
    starts = np.arange(blocks) * size
    counts = np.diff([*starts, len(signal)])
    return np.add.reduceat(signal, starts, axis=0) / counts[:, None]
