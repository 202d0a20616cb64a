"""How far a model file is from a recorded motion, driven by the recorded torques alone."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.robot.formats.mjcf_spec import LINEAR, commands_kept, parse
from testbed.core.robot.model_file import ModelFile, model_format
from testbed.lab.simulation.plant import robot_spec

STEP = 1e-3
"""Longest step [s]."""

START = 0.1
"""Time before and after the start over which the first velocities are fitted [s]."""


def replay(model: ModelFile, recording: Recording, seconds: float = 2.0) -> Array:
    """Distance from the recorded positions in MuJoCo, driven open-loop, (M, n) [rad or m].

    Motors have gears and delays of the file's own, one and none where it has none. Between samples
    the torque is linear in time. Positions and velocities at the start are those of a cubic fit.

    Args:
        model: The model file, and how it is read.
        recording: With torques, as the drives report them.
        seconds: How long, or as long as the recording lasts.

    Raises:
        RecordingError: It is too short, or has no torques.
        ModelError: MuJoCo refuses the file.
    """
    tree = model.tree()
    part = recording.ordered(tree)
    time, torque, recorded = part.time, part.measured("torque"), part.position
    first, fitted, last = np.searchsorted(
        time, time[0] + [START, 2 * START, START + seconds], side="right"
    )
    last = min(last, len(time) - 1)
    if last <= fitted:
        raise RecordingError(
            f"a recording that is replayed lasts more than {2 * START:g} s"
        )
    period = float((time[last] - time[first]) / (last - first))
    steps = int(np.ceil(period / STEP))
    plant = _plant(model, tree.names, period / steps)
    data = mujoco.MjData(plant)
    _recall(plant, data, time - time[first], torque)
    # each has one position
    order = [plant.joint(name).dofadr[0] for name in tree.names]
    fit = np.polynomial.polynomial.polyfit(
        time[:fitted] - time[first], recorded[:fitted], 3
    )
    data.qpos[order], data.qvel[order] = fit[:2]
    simulated = []
    for k in range(first, last):
        simulated.append(data.qpos[order])
        for share in (np.arange(steps) + 0.5) / steps:
            data.ctrl[:] = torque[k] + share * (torque[k + 1] - torque[k])
            mujoco.mj_step(plant, data)
    return np.array(simulated) - recorded[first:last]


def _recall(
    plant: mujoco.MjModel, data: mujoco.MjData, time: Array, torque: Array
) -> None:
    """Give delayed motors the commands from before the start, t = 0."""
    for late in np.flatnonzero(plant.actuator_delay).tolist():
        before = plant.opt.timestep * np.arange(-plant.actuator_history[late, 0], 0.0)
        known = np.interp(before, time, torque[:, late])
        mujoco.mj_initCtrlHistory(plant, data, late, before[:, None], known[:, None])


def _plant(model: ModelFile, names: Sequence[str], step: float) -> mujoco.MjModel:
    """The robot with a motor at each joint, with gear and delay of the file's own."""
    spec = robot_spec(model)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.timestep = step
    own = [] if model_format(model.path) == "urdf" else parse(model.path).actuators
    known = {each.target: (float(each.gear[0]), float(each.delay)) for each in own}
    for name in names:
        gear, delay = known.get(name, (1.0, 0.0))
        motor = spec.add_actuator(target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.gear = [gear, 0, 0, 0, 0, 0]
        motor.delay, motor.interp = delay, LINEAR
        motor.nsample = commands_kept(delay, step)
    return spec.compile()
