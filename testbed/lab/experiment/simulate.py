"""Simulate a rig along a motion: its plant on the bedplate, its controller, its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import make_interp_spline

from testbed.core.base.arrays import Array
from testbed.core.base.contents import fingerprint
from testbed.core.base.diagnostics import diagnose
from testbed.core.base.errors import ExperimentError, SettingsError
from testbed.core.base.installation import versions
from testbed.core.base.stages import Progress, unreported
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.recordings.geometry import geometry
from testbed.core.recordings.metadata import Metadata, three
from testbed.core.recordings.recording import Recording
from testbed.core.robot.rotations import to_rpy
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.rig import Rig
from testbed.lab.experiment.sensors import ForcePlate, JointTorques
from testbed.lab.instruments.chain import measure, with_sensors
from testbed.lab.simulation.controller import Reference
from testbed.lab.simulation.effect import StepForces
from testbed.lab.simulation.gear_friction import Gears
from testbed.lab.simulation.plant import build_plant
from testbed.lab.simulation.rollout import Rollout, Sampling, Watch, simulate_motion


@runtime_checkable
class FromRest(Reference, Protocol):
    """A motion from rest to rest, its periodic part from zero."""

    @property
    def lead(self) -> float:
        """Duration of the start before zero, and of the way to rest after the end [s]."""

    @property
    def end(self) -> float:
        """End of the periodic part [s]."""


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """A motion through samples, by splines of fifth degree; at rest in its ends beyond them.

    Attributes:
        samples: Times from zero, (M,) [s], and positions, (M, n) [rad or m]; M at least six.
    """

    samples: Motion

    @property
    def period(self) -> float:
        """Duration [s]."""
        return float(self.samples.t[-1])

    @cached_property
    def _spline(self) -> Any:
        return make_interp_spline(self.samples.t, self.samples.q, k=5)

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s]."""
        moving = (t >= 0) & (t <= self.period)
        rates = [
            moving[:, None] * self._spline(self.place(t), order) for order in (1, 2)
        ]
        return Motion(t, self._spline(self.place(t)), *rates)

    def place(self, t: Array) -> Array:
        """Times on its path, (M,) [s]."""
        return np.clip(t, 0.0, self.period)


def simulate(
    rig: Rig,
    motion: Reference | Motion,
    seconds: float = 60.0,
    seed: int = 0,
    *,
    progress: Progress = unreported,
    watch: Watch = unreported,
    forces: StepForces | None = None,
    installed: int | None = None,
) -> Recording:
    """Simulate a robot on its bedplate and measure it.

    Args:
        rig: Robot, plant and sensors.
        motion: Periodic, as `random_motion` or `design` gives it; from rest to rest; or one's
            own samples `Motion(t, q, qd, qdd)`, of which positions count.
        seconds: Length of the recording [s]; a motion from rest to rest and samples have their
            own.
        seed: Of all noise.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        forces: On the joints, besides motors, friction and the plant's, asked before every step.
        installed: Seed of signs and phases that sensors keep; default `seed`.

    Returns:
        What the sensors show; `truth` holds what happened, and no estimator reads it.

    Raises:
        ModelError: The robot has no model file, or MuJoCo makes another robot of it.
        SettingsError: Values do not fit each other or the robot.
        SimulationDiverged: The robot did not follow.
    """
    if not isinstance(rig, Rig):
        raise SettingsError(
            f"simulate(rig, motion): rig is a Rig, found a {type(rig).__name__}"
        )
    reference, begin, end = _course(rig, motion, seconds)
    sampling = Sampling(rig.rate, rig.steps(end), rig.averaged, rig.warm_up, begin)
    tree, model = rig.true_robot, rig.file
    gears = _gears(rig, tree)
    plant = build_plant(
        model,
        tree,
        rig.step,
        changed=tree.names,
        friction=rig.friction,
        effects=rig.plant,
        sensors=list(rig.mounted),
    )
    happened = simulate_motion(
        plant,
        tree if rig.friction else tree.without_friction(),
        reference,
        end,
        rig.bandwidth,
        sampling,
        progress,
        watch,
        _forces(rig, tree, forces),
        gears,
    )
    metadata = _metadata(rig, tree, happened, seed)
    if isinstance(motion, FromRest):
        metadata = replace(metadata, counted=(0.0, motion.end))
    return _measured(rig, happened, plant.tare, metadata, seed, installed)


def _course(
    rig: Rig, motion: Reference | Motion, seconds: float
) -> tuple[Reference, float, float]:
    """What the controller follows, when the recording begins and ends [s]."""
    if isinstance(motion, FromRest):
        return motion, -motion.lead, motion.end + motion.lead
    found: Reference = SampledMotion(motion) if isinstance(motion, Motion) else motion
    joints = found.at(np.zeros(1)).q.shape[1]
    if joints != rig.robot.n:
        raise SettingsError(
            f"the motion is of {joints} joints, the robot has {rig.robot.n}"
        )
    return (
        found,
        0.0,
        min(seconds, found.period) if isinstance(motion, Motion) else seconds,
    )


def _forces(rig: Rig, tree: Tree, more: StepForces | None) -> StepForces | None:
    """Sum of the forces of effects and of a caller; None for nothing."""
    asked = [effect.forces(tree, rig.step) for effect in rig.plant]
    pushes = [push for push in (*asked, more) if push is not None]
    if not pushes:
        return None

    def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
        return np.asarray(sum(each(time, q, qd, motor) for each in pushes))

    return push


def _gears(rig: Rig, tree: Tree) -> Gears | None:
    """Friction of gears that is solved with the motion; None for none.

    Raises:
        ExperimentError: Two effects take the place of the joints' own friction, or joints are
            coupled.
    """
    owners = [effect.kind for effect in rig.plant if effect.owns_friction]
    if len(owners) > 1:
        raise ExperimentError(
            f"{' and '.join(owners)} both take the place of the joints' own friction: choose one"
        )
    found = [gears for effect in rig.plant if (gears := effect.gears(tree)) is not None]
    if found and tree.shafts:
        raise ExperimentError(
            f"{owners[0]} is of joints with gears of their own, not of couplings"
        )
    return found[0] if found else None


def _measured(
    rig: Rig,
    happened: Rollout,
    tare: Array,
    metadata: Metadata,
    seed: int,
    installed: int | None,
) -> Recording:
    """What the sensors show of what happened."""
    names, time = rig.robot.names, happened.time
    found = measure(
        rig.instrument, names, time, happened.truth, tare, metadata, seed, installed
    )
    for effect in rig.plant:
        warmth = effect.temperature(time)
        if warmth is not None:
            found = replace(
                found, temperature=np.broadcast_to(warmth, found.position.shape)
            )
    mounted = {place.name: rig.instrument_of(own) for place, own in rig.mounted.items()}
    if mounted:
        found = with_sensors(found, mounted, seed, installed)
    kinds = [type(sensor) for sensor in rig.outer]
    if JointTorques not in kinds:
        found = replace(found, torque=None)
    return found if ForcePlate in kinds else replace(found, wrench=None, tare=None)


def _metadata(rig: Rig, tree: Tree, run: Rollout, seed: int) -> Metadata:
    """Metadata of a simulated recording."""
    saturated = (
        diagnose("motion.saturated", name, share)
        for name, share in zip(tree.names, run.saturated, strict=True)
        if share
    )
    places = {
        place.name: {
            "link": place.link,
            "position": place.position.tolist(),
            "rpy": list(to_rpy(place.rotation)),
        }
        for place in rig.mounted
    }
    tracking = dict(zip(tree.names, run.tracking.tolist(), strict=True))
    return Metadata(
        robot=tree.name,
        gravity=three(tree.gravity),
        geometry=geometry(tree),
        sensors=places,
        diagnostics=tuple(saturated),
        model_sha256=fingerprint(rig.file.path),
        others={"seed": seed, "versions": versions(), "tracking_rms": tracking},
    )
