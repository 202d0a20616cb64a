"""What there is to see of a run, computed: motion, predictions, moments, sizes."""

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
from testbed.lab.experiment.summary import summary, verdict
from testbed.view.drives import TITLE, drive_table
from testbed.view.estimates import instrument_tables

PRESSED = 0.05
"""Part of the largest force that must press for there to be a centre of pressure."""
POSES = 50.0
"""Poses shown a second [Hz]; the eye sees no more."""
WINDOW = 10.0
"""What is seen first [s]."""
CUTOFF = 10.0
"""Of the low-pass on residuals: motions are slower [Hz]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One run, ready to be shown.

    Attributes:
        predictions: The run's recording beside what its estimates say of it.
        appearance: What the robot looks like.
    """

    predictions: Predictions
    appearance: Appearance

    @property
    def run(self) -> Run:
        """The run."""
        return self.predictions.run

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What a careful reader should know, of the run and of what cannot be shown."""
        return (*self.run.diagnostics, *self.appearance.diagnostics)

    @property
    def motion(self) -> Motion:
        """What the recording shows, without the ends that filters take."""
        return self.predictions.motion

    @property
    def frames(self) -> slice:
        """Samples of the motion at which poses are shown."""
        return slice(
            0, self.motion.samples, max(1, round(self.run.recording.rate / POSES))
        )

    @cached_property
    def smooth(self) -> Predictions:
        """The predictions through one low-pass."""
        return self.predictions.smoothed(CUTOFF)

    @cached_property
    def wrench(self) -> Array | None:
        """The measured wrench over the motion, (M, 6) [N, N m]; None if there was no plate."""
        channels = self.predictions.channels
        found = [each.measured for each in channels if each.kind == "wrench"]
        return np.column_stack(found) if found else None

    @cached_property
    def span(self) -> float:
        """How far from the bedplate's origin the robot reached [m]; at least 0.3."""
        return span_of(self.appearance, self.motion.q[self.frames])

    @property
    def window(self) -> tuple[float, float]:
        """The seconds seen first: those in which the viewer's clock begins."""
        time = self.run.recording.time
        return float(time[0]), float(min(time[0] + WINDOW, time[-1]))

    @cached_property
    def notes(self) -> str:
        """What was found and what to be careful about, as Markdown."""
        run = self.run
        said = [line for line in (*summary(run), verdict(run)) if line]
        lines = [f"# {plain(run.name)}", *(plain(line) for line in said)]
        if run.experiment is not None and run.experiment.claim:
            lines.insert(1, f"**Claim.** {plain(run.experiment.claim)}")
        if run.drives is not None:
            lines += [f"## {TITLE}", drive_table(run.drives.estimates).markdown]
        for table in instrument_tables(run):
            lines += [f"## {table.title}", table.markdown]
        if self.diagnostics:
            lines.append("## Warnings")
            lines.append(
                "\n".join(f"- {plain(line)}" for line in sentences(self.diagnostics))
            )
        return "\n\n".join(lines)


def scene_of(run: Run) -> Scene:
    """Compute what there is to see of a run.

    Args:
        run: The run.
    """
    appearance = load_appearance(run.tree, run.model)
    return Scene(predict(run), appearance)


def span_of(look: Appearance, q: Array) -> float:
    """How far from the bedplate's origin a robot reaches [m]; at least 0.3.

    Args:
        look: The robot.
        q: Its postures, (M, n) [rad or m].
    """
    placed = poses(look.tree, q)
    far = [X_WB.p_AB_A for X_WB in placed]
    far += [placed[j].point(tip) for j, tip in look.tips.items()]
    return max(0.3, *(float(np.linalg.norm(points, axis=1).max()) for points in far))


def root(k: int, count: int) -> str:
    """Where the k-th of several runs stands among the entities."""
    return "" if count == 1 else f"/run{k + 1}"


def safe(name: str) -> str:
    """A joint's or parameter's name as one part of an entity's path."""
    return str(rr.escape_entity_path_part(name))


def entity(at: str, channel: Channel) -> str:
    """Rerun entity path of a channel's time series below a parent path."""
    return f"{at}/{channel.kind}/{safe(channel.name)}"


def plain(text: str) -> str:
    """Text that Markdown takes as it is: asterisks of parameters' names, for one."""
    return re.sub(r"([\\`*_{}\[\]()#+.!<>|~-])", r"\\\1", text)


def pressure(wrench: Array) -> Array:
    """Centre of pressure on the bedplate's plane z = 0, (M, 2) [m]; nan where it is hardly pressed.

    Args:
        wrench: Of the bedplate on the robot, (M, 6) [N, N m].
    """
    fz = wrench[:, 2]
    pressed = fz > PRESSED * np.abs(wrench[:, :3]).max(initial=1e-9)
    pressing = np.where(pressed, fz, np.nan)
    return np.column_stack([-wrench[:, 4] / pressing, wrench[:, 3] / pressing])


def means(signal: Array, size: int) -> Array:
    """Means of consecutive blocks of `size` samples, (blocks, k)."""
    blocks = -(-len(signal) // size)
    starts = np.arange(blocks) * size
    counts = np.diff([*starts, len(signal)])
    return np.add.reduceat(signal, starts, axis=0) / counts[:, None]
