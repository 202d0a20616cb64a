"""What an experiment records: robot, motion, plant and drive made ready, then simulated."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import diagnose
from testbed.core.base.errors import ExperimentError
from testbed.core.base.files import fingerprint
from testbed.core.base.installation import versions
from testbed.core.recordings.columns import COUNTED
from testbed.core.recordings.geometry import geometry
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_robot import effects_of, model_of, robot_of
from testbed.lab.experiment.motions import FAST, motion_of, rules_of
from testbed.lab.instruments.chain import measure, with_sensors
from testbed.lab.instruments.fault import stream
from testbed.lab.simulation.controller import Reference, believed
from testbed.lab.simulation.effect import StepForces
from testbed.lab.simulation.gear_friction import Gears
from testbed.lab.simulation.plant import Plant, build_plant
from testbed.lab.simulation.rollout import Rollout, Sampling, Watch, simulate_motion
from testbed.motion.fourier import Fourier
from testbed.motion.rest_to_rest import rest_to_rest

MOST_SAMPLES = 2e6
"""Most samples of one run: they are held in memory."""

LEAST_PERIODS = 0.1
"""Least part of the fastest harmonic's period that is a motion."""

Plants: TypeAlias = dict[str, Plant]
"""By all that is said of them."""

MOST_STEPS = 10_000
"""Most simulation steps a sample: a thousand samples are held in full."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """An experiment that is ready to be simulated.

    Attributes:
        experiment: What is to be done.
        tree: Its robot.
        plant: The robot on its bedplate.
        model: The robot as its drive believes it to be.
        path: The periodic motion, under way or part of one from rest to rest.
        reference: What the drive follows.
        end: Of the recording [s].
        facts: What the recording says of its motion.
        sampling: How the run is cut into samples.
        forces: On the joints, besides motors and the model's friction; None for none.
        gears: Whose friction is solved with the motion, in place of the model's; None for none.
    """

    experiment: Experiment
    tree: Tree
    plant: Plant
    model: Tree
    path: Fourier
    reference: Reference
    end: float
    facts: Mapping[str, Any]
    sampling: Sampling
    forces: StepForces | None
    gears: Gears | None = None

    @property
    def happens(self) -> Hashable:
        """What determines all that happens, whoever measures it."""
        said, motion = self.experiment, self.path
        seed = said.seed if said.simulation.drive_model_error else None
        shapes = motion.offset.tobytes(), motion.sine.tobytes(), motion.cosine.tobytes()
        clock = self.end, self.sampling
        return clock, _plant_words(said), motion.fundamental, shapes, seed

    def rollout(
        self,
        progress: Callable[[int, int], None] = lambda done, total: None,
        watch: Watch = lambda time, truth: None,
    ) -> Rollout:
        """Simulate it.

        Args:
            progress: Called with samples done and samples in all.
            watch: Called with what happens while it is simulated, a second or so at a time.

        Raises:
            SimulationDiverged: The robot did not follow.
        """
        return simulate_motion(
            self.plant,
            self.model,
            self.reference,
            self.end,
            self.experiment.simulation.bandwidth,
            self.sampling,
            progress,
            watch,
            self.forces,
            self.gears,
        )


def prepare(
    experiment: Experiment,
    forces: StepForces | None,
    plants: Plants | None = None,
    motion: Fourier | None = None,
) -> Prepared:
    """Read the robot, choose the motion, build the plant.

    Args:
        experiment: What to do.
        forces: On the joints, besides motors, the model's friction and effects.
        plants: Of other experiments: one that is the same is taken, a new one is put in.
        motion: In place of the experiment's.

    Raises:
        TestbedError: It cannot be carried out as written.
    """
    tree, sampling = robot_of(experiment), _sampling(experiment)
    simulation = experiment.simulation
    experiment.measurement.stages(tree.names)  # refuses what names other joints before work
    experiment.sensed(tree, model_of(experiment))  # so does a sensor at a link that is not there
    path = motion or motion_of(experiment, tree)
    reference, begin, end, facts = _course(experiment, tree, path)
    known = {} if plants is None else plants
    words = _plant_words(experiment)
    if words not in known:
        known[words] = build_plant(
            model_of(experiment),
            tree,
            simulation.step,
            changed=experiment.robot.joint,
            friction=simulation.friction,
            effects=effects_of(experiment, tree),
            sensors=list(experiment.force_sensors.values()),
        )
    return Prepared(
        experiment,
        tree,
        known[words],
        _drives_model(experiment, tree),
        path,
        reference,
        end,
        facts,
        replace(sampling, begin=begin),
        _forces(experiment, tree, forces),
        _gears(experiment, tree),
    )


def _course(
    experiment: Experiment, tree: Tree, path: Fourier
) -> tuple[Reference, float, float, Mapping[str, Any]]:
    """A periodic motion that is under way, or the same from rest to rest.

    Returns:
        What the drive follows, when the recording begins and ends [s], what it says of it.
    """
    table = experiment.motion
    if not table.at_rest:
        return path, 0.0, table.duration, {}
    rules = rules_of(experiment, tree, designed=bool(table.file))
    whole = rest_to_rest(path, rules, table.duration)
    lead = whole.start.duration
    return whole, -lead, whole.end + lead, {COUNTED: [0.0, whole.end]}


def _plant_words(experiment: Experiment) -> str:
    """All that an experiment says of its plant and drive, as one text."""
    said = experiment.force_sensors
    parts = {"model", "gravity", "weld_root", "robot", "simulation"}
    sensors = [(s.name, s.link, s.position.tolist(), s.rotation.tolist()) for s in said.values()]
    whole = experiment.model_copy(
        update={"robot": experiment.robot.model_copy(update={"sensor": ""})}
    )
    return f"{whole.model_dump_json(include=parts)} {sensors}"


def _forces(experiment: Experiment, tree: Tree, more: StepForces | None) -> StepForces | None:
    """What effects and a caller push the joints with; None for nothing."""
    step = experiment.simulation.step
    asked = [effect.forces(tree, step) for effect in effects_of(experiment, tree)]
    pushes = [push for push in (*asked, more) if push is not None]
    if not pushes:
        return None

    def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
        return np.asarray(sum(each(time, q, qd, motor) for each in pushes))

    return push


def _gears(experiment: Experiment, tree: Tree) -> Gears | None:
    """Whose friction is solved with the motion; None for nobody's.

    Raises:
        ExperimentError: Two effects take the place of the joints' own friction, or joints are
            coupled, of which the solution does not know.
    """
    effects = effects_of(experiment, tree)
    owners = [effect.kind for effect in effects if effect.owns_friction]
    if len(owners) > 1:
        raise ExperimentError(
            f"{' and '.join(owners)} both take the place of the joints' own friction: choose one"
        )
    found = [gears for effect in effects if (gears := effect.gears(tree)) is not None]
    if found and tree.shafts:
        raise ExperimentError(f"{owners[0]} is of joints with gears of their own, not of couplings")
    return found[0] if found else None


def _drives_model(experiment: Experiment, tree: Tree) -> Tree:
    """The robot as its controller believes it to be."""
    simulation = experiment.simulation
    own = tree if simulation.friction else tree.without_friction()
    if not simulation.drive_model_error:
        return own
    rng = stream("drive_model_error", experiment.seed)
    return believed(own, simulation.drive_model_error, rng)


def _sampling(experiment: Experiment) -> Sampling:
    """How the run is cut into samples.

    Raises:
        ExperimentError: The step does not divide the sample, or there are too many.
    """
    simulation, table, motion = experiment.simulation, experiment.measurement, experiment.motion
    _check_rates(experiment)
    wanted = 1 / table.rate / simulation.step  # may be without end
    if wanted > MOST_STEPS:
        raise ExperimentError(
            f"simulation.step = {simulation.step:g} s makes {wanted:.6g} steps a sample, more than "
            f"{MOST_STEPS}; choose a larger step"
        )
    steps = round(wanted)
    if steps < 1 or abs(steps * table.rate * simulation.step - 1) > 1e-9:
        raise ExperimentError(
            f"simulation.step = {simulation.step:g} s does not divide the sampling time "
            f"1 / measurement.rate = {1 / table.rate:g} s"
        )
    samples = table.rate * (motion.duration + simulation.warm_up)
    if table.rate * motion.duration < 2:
        raise ExperimentError(f"motion.duration = {motion.duration:g} s holds no two samples")
    if samples > MOST_SAMPLES:
        raise ExperimentError(
            f"motion.duration and measurement.rate make {samples:.1e} samples, more than the "
            f"{MOST_SAMPLES:.0e} that one run holds in memory; make several runs"
        )
    return Sampling(table.rate, steps, table.averaged, simulation.warm_up)


def _check_rates(experiment: Experiment) -> None:
    """Whether controller and motion fit the rate and each other.

    Raises:
        ExperimentError: They do not.
    """
    motion, rate = experiment.motion, experiment.measurement.rate
    if experiment.simulation.bandwidth > rate / 2:
        raise ExperimentError(
            f"simulation.bandwidth = {experiment.simulation.bandwidth:g} rad/s is too fast for a "
            f"controller at measurement.rate = {rate:g} Hz; lower it to {rate / 2:g} or less"
        )
    if not motion.file and FAST * motion.fundamental * motion.harmonics > rate:
        raise ExperimentError(
            f"a motion of up to {motion.fundamental * motion.harmonics:g} Hz (motion.fundamental "
            f"times motion.harmonics) is too fast for measurement.rate = {rate:g} Hz"
        )
    periods = motion.fundamental * motion.harmonics * motion.duration
    if not motion.file and periods < LEAST_PERIODS:
        raise ExperimentError(
            f"motion.duration = {motion.duration:g} s is {periods:.2g} of a period of the fastest "
            "harmonic (motion.fundamental times motion.harmonics): the robot would hardly move"
        )


def simulate(
    experiment: Experiment,
    progress: Callable[[int, int], None] = lambda done, total: None,
    watch: Watch = lambda time, truth: None,
    forces: StepForces | None = None,
    installed: int | None = None,
    motion: Fourier | None = None,
) -> Recording:
    """Simulate an experiment's robot on its bedplate and measure it.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        forces: On the joints, besides motors and the model's friction, asked before every step.
        installed: Seed of what chance decides once of the instrument; default the experiment's.
        motion: In place of the experiment's.
    """
    ready = prepare(experiment, forces, motion=motion)
    return _measured(ready, ready.rollout(progress, watch), installed)


def _measured(ready: Prepared, happened: Rollout, installed: int | None = None) -> Recording:
    """What the instrument shows of it."""
    experiment, tree, time = ready.experiment, ready.tree, happened.time
    facts = _facts(experiment, tree, happened) | dict(ready.facts)
    instrument, names, seed = experiment.measurement, tree.names, experiment.seed
    tare, truth = ready.plant.tare, happened.truth
    found = measure(instrument, names, time, truth, tare, facts, seed, installed)
    for effect in effects_of(experiment, tree):
        warmth = effect.temperature(time)
        if warmth is not None:
            found = replace(found, temperature=np.broadcast_to(warmth, found.position.shape))
    sensors = experiment.sensor_instruments
    return with_sensors(found, sensors, seed, installed) if sensors else found


def simulate_together(experiments: Sequence[Experiment]) -> Iterator[Recording | Exception]:
    """Simulate experiments; what happens twice only once.

    Every recording is, to the bit, the one that `simulate` makes of its experiment.

    Args:
        experiments: What to do.

    Yields:
        Of each experiment its recording, or why there is none.
    """
    plants: Plants = {}
    happened: dict[Hashable, Rollout | Exception] = {}
    for experiment in experiments:
        try:
            ready = prepare(experiment, None, plants)
            if ready.happens not in happened:
                happened[ready.happens] = _rollout(ready)
            result = happened[ready.happens]
            yield result if isinstance(result, Exception) else _measured(ready, result)
        except Exception as error:
            yield error


def _rollout(ready: Prepared) -> Rollout | Exception:
    try:
        return ready.rollout()
    except Exception as error:
        return error


def _facts(experiment: Experiment, tree: Tree, run: Rollout) -> dict[str, Any]:
    """What a recording keeps about how it was made."""
    saturated = [
        diagnose("motion.saturated", name, share).as_dict()
        for name, share in zip(tree.names, run.saturated, strict=True)
        if share
    ]
    return {
        "robot": tree.name,
        "geometry": geometry(tree),
        "gravity": tree.gravity.tolist(),
        "model_sha256": fingerprint(Path(experiment.model)),
        "seed": experiment.seed,
        "versions": versions(),
        "tracking_rms": dict(zip(tree.names, run.tracking.tolist(), strict=True)),
        "diagnostics": saturated,
        **({"sensors": experiment.sensor_places} if experiment.force_sensors else {}),
    }
