"""The robot of an experiment, its model file, and what else is in its plant."""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ExperimentError
from testbed.core.robot.model_file import ModelFile, mimic_joints, nearest_bodies
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.rig import Encoders, ForcePlate, JointTorques, Rig, Sensor
from testbed.lab.experiment.robot_tables import BodyTable
from testbed.lab.instruments.chain import Instrument


def rig_of(experiment: Experiment) -> Rig:
    """The rig of an experiment: its robot under its gravity, plant and sensors.

    Args:
        experiment: Names the model file.

    Raises:
        UnknownName: A table names a joint that the robot has not.
        ExperimentError: The base is measured, and not on a bedplate.
    """
    tree = model_of(experiment).tree()
    for name in (*experiment.motion.max_velocity, *experiment.motion.max_acceleration):
        tree.index(name)  # refuses joints that are not there
    if experiment.robot.base == "measured":
        raise ExperimentError(
            'robot.base = "measured" is for recordings: experiments have a bedplate'
        )
    how = experiment.measurement
    return Rig(
        robot=experiment.robot.on(tree).with_gravity(experiment.gravity),
        plant=experiment.simulation.effect,
        sensors=(*sensors_of(how), *experiment.mounted_sensors),
        rate=how.rate,
        averaged=how.averaged,
        **experiment.simulation.model_dump(exclude={"effect"}),
    )


def sensors_of(how: Instrument) -> tuple[Sensor, ...]:
    """Sensors as the table [measurement] has them.

    Args:
        how: The table.
    """
    signals = ("position", "torque", "wrench", "tare")
    errors = {s: [fault for fault in how.fault if fault.signal == s] for s in signals}
    gains = {joint: 1 + error for joint, error in how.torque_constant_error.items()}
    return (
        Encoders(
            how.encoder_resolution,
            how.encoder_noise,
            how.senses_kinematics,
            errors["position"],
        ),
        JointTorques(how.torque_noise, gains, errors["torque"]),
        ForcePlate(
            (how.force_noise, how.moment_noise),
            errors["wrench"] + errors["tare"],
            how.full_scale,
        ),
    )


def robot_of(experiment: Experiment) -> Tree:
    """The robot of an experiment with what its plant adds to it, under its gravity."""
    return rig_of(experiment).true_robot


def sensed_robot(experiment: Experiment) -> Tree:
    """What an experiment's wrench is of: its robot, or what lies beyond its force sensor."""
    return experiment.sensed(robot_of(experiment), model_of(experiment))


def model_of(experiment: Experiment) -> ModelFile:
    """The model file of an experiment, and how it is read.

    Args:
        experiment: Says so in `model`, `weld_root` and its table `robot`.
    """
    mimic = mimic_joints(experiment.model) if experiment.robot.lock_mimic else ()
    held = dict.fromkeys(mimic) | experiment.robot.lock
    welded, bodies = experiment.weld_root, experiment.robot.bodies
    return ModelFile(Path(experiment.model), weld_root=welded, repair=bodies, lock=held)


def with_nearest_bodies(experiment: Experiment) -> tuple[Experiment, tuple[Diagnostic, ...]]:
    """The same with the nearest bodies in place of those that cannot be, and what to say of it.

    Args:
        experiment: Of a model file and nothing else.
    """
    model = model_of(experiment)
    found = nearest_bodies(model.path, weld_root=model.weld_root, lock=model.lock)
    tables = {name: BodyTable.of(body) for name, body in found.bodies.items()}
    robot = experiment.robot.model_copy(update={"repair": tables | experiment.robot.repair})
    return experiment.model_copy(update={"robot": robot}), found.diagnostics
