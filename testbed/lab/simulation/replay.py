"""Comparison of a model with a recorded motion, by open-loop simulation of recorded torques."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.robot.formats.mjcf_spec import (
    LINEAR_INTERPOLATION,
    buffered_command_count,
    parse_mjcf,
)
from testbed.core.robot.model_file import ModelFile, model_format
from testbed.lab.simulation.plant import robot_spec

MAX_STEP = 1e-3
"""Longest integration step [s]."""

START_INTERVAL = 0.1
"""Duration of the intervals before and after the start, for the fit of initial velocities [s]."""


def replay_errors(
    model: ModelFile, recording: Recording, duration: float = 2.0
) -> Array:
    """Error of simulated positions under the recorded torques, (M, n) [rad or m].

    The error is `simulated - recorded`. The simulation is open-loop and without contacts; it starts
    `START_INTERVAL` after the beginning of the recording. Motors have the gear ratios and delays of
    the model file, by default 1 and 0. The torque is interpolated linearly between samples. The
    initial positions and velocities are those of a cubic polynomial fitted to the positions within
    `START_INTERVAL` of the start.

    Args:
        model: Model file, and the settings used to read it.
        recording: Recording with the torques that the drives reported.
        duration: Duration of the simulation, at most to the end of the recording [s].

    Raises:
        RecordingError: The recording is too short, or has no torques.
        ModelError: MuJoCo refuses the file.
    """
    tree = model.tree()
    part = recording.ordered(tree)
    time, torque, recorded = part.time, part.measured("torque"), part.position
    first, fit_end, last = np.searchsorted(
        time,
        time[0] + [START_INTERVAL, 2 * START_INTERVAL, START_INTERVAL + duration],
        side="right",
    )
    last = min(last, len(time) - 1)
    if last <= fit_end:
        raise RecordingError(
            f"a recording that is replayed lasts more than {2 * START_INTERVAL:g} s"
        )
    period = float((time[last] - time[first]) / (last - first))
    steps = int(np.ceil(period / MAX_STEP))
    plant = _motorised_model(model, tree.names, period / steps)
    data = mujoco.MjData(plant)
    _initialise_delays(plant, data, time - time[first], torque)
    # each joint has one position and one velocity
    order = [plant.joint(name).dofadr[0] for name in tree.names]
    fit = np.polynomial.polynomial.polyfit(
        time[:fit_end] - time[first], recorded[:fit_end], 3
    )
    data.qpos[order], data.qvel[order] = fit[:2]
    simulated = []
    for k in range(first, last):
        simulated.append(data.qpos[order])
        for fraction in (np.arange(steps) + 0.5) / steps:
            data.ctrl[:] = torque[k] + fraction * (torque[k + 1] - torque[k])
            mujoco.mj_step(plant, data)
    return np.array(simulated) - recorded[first:last]


def _initialise_delays(
    plant: mujoco.MjModel, data: mujoco.MjData, time: Array, torque: Array
) -> None:
    """Fill the command history of delayed motors with the torques before the start, t = 0.

    Args:
        plant: Model with motors.
        data: State of the model, modified.
        time: Times of the samples from the start of the simulation, (M,) [s].
        torque: Recorded torques, (M, n) [N m or N]; interpolated linearly.
    """
    for actuator in np.flatnonzero(plant.actuator_delay).tolist():
        history_times = plant.opt.timestep * np.arange(
            -plant.actuator_history[actuator, 0], 0.0
        )
        commands = np.interp(history_times, time, torque[:, actuator])
        mujoco.mj_initCtrlHistory(
            plant, data, actuator, history_times[:, None], commands[:, None]
        )


def _motorised_model(
    model: ModelFile, names: Sequence[str], step: float
) -> mujoco.MjModel:
    """Compiled model of a robot with a motor at each joint, without contacts.

    Gear ratio and delay are those of the joint's actuator in an MJCF file, otherwise 1 and 0.

    Args:
        model: Model file, and the settings used to read it.
        names: Joint names, in the order of the motors.
        step: Integration step [s].
    """
    spec = robot_spec(model)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.timestep = step
    actuators = (
        [] if model_format(model.path) == "urdf" else parse_mjcf(model.path).actuators
    )
    gears_and_delays = {
        each.target: (float(each.gear[0]), float(each.delay)) for each in actuators
    }
    for name in names:
        gear, delay = gears_and_delays.get(name, (1.0, 0.0))
        motor = spec.add_actuator(target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.gear = [gear, 0, 0, 0, 0, 0]
        motor.delay, motor.interp = delay, LINEAR_INTERPOLATION
        motor.nsample = buffered_command_count(delay, step)
    return spec.compile()
