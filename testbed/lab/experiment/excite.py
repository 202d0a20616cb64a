"""From an experiment to the most informative motion: designed, proven, predicted."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import encode
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import ExperimentError, TestbedError, few
from testbed.core.base.files import fingerprint, replacing
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.regression.windows import (
    drive_filter,
    motion_taps,
    reversal_samples,
    row_weights,
)
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Model
from testbed.core.recordings.columns import UNITS
from testbed.core.recordings.formats.parquet import write_table
from testbed.core.robot.friction import BY_LOAD, LOAD, JointLaw
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.evaluate import model_of, robot_of
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import motion_of, plate_noise_of, rules_of
from testbed.lab.experiment.results import versions
from testbed.motion.design import Design, Watch, Wish, design
from testbed.motion.fourier import Fourier
from testbed.motion.information import Pipeline, Prediction, information_of, models_of, predict
from testbed.motion.limits import Limits
from testbed.motion.proof import Rules
from testbed.motion.rest_to_rest import RestToRest, rest_to_rest
from testbed.motion.samples import SampledRows

QUIET_TORQUE = 0.5
"""Noise assumed of joint torques that have none [N m or N]."""

FEWEST = 3
"""Harmonics of a motion worth searching."""


@dataclass(frozen=True, eq=False)
class Excitation(Diagnosed):
    """A designed motion beside a random one.

    Attributes:
        experiment: What it was made for.
        tree: The robot.
        rules: What it respects.
        design: The motion and its proof.
        predicted: What it promises.
        random: The motion that the experiment would run otherwise; None where there is none.
        random_predicted: What that promises.
    """

    experiment: Experiment
    tree: Tree
    rules: Rules
    design: Design
    predicted: Prediction
    random: Fourier | None
    random_predicted: Prediction | None

    def document(self) -> dict[str, Any]:
        """For programs: what was designed, what it promises, what a random motion would."""
        motion, random = self.design.motion, self.random_predicted
        return {
            "fundamental": motion.fundamental,
            "harmonics": motion.harmonics,
            "aim": self.experiment.excitation.aim,
            "criterion": self.experiment.excitation.judged_by,
            "value": self.design.value,
            "complete": self.design.complete,
            "searches": [encode(search) for search in self.design.searches],
            "predicted": encode(self.predicted),
            "random": None if random is None else encode(random),
            "gain": self.gain,
            "diagnostics": [encode(each) for each in self.diagnostics],
            "proof": encode(self.design.proof),
        }

    @property
    def gain(self) -> float | None:
        """How many times smaller relative sigmas are than the random motion's: their mean.

        None where there is no random motion, or one that does not identify all parameters.
        """
        random = self.random_predicted
        if random is None or not np.isfinite(random.rms):
            return None
        return self.mean(random) / self.mean(self.predicted)

    @property
    def kind_of_mean(self) -> str:
        """Rms of sigmas of bodies; those of friction differ in units, and with them in size."""
        return "rms" if self.experiment.excitation.aim == "bodies" else "geometric mean"

    def mean(self, predicted: Prediction) -> float:
        """Of relative sigmas, of that kind."""
        geometric = float(np.exp(np.mean(np.log(predicted.relative))))
        return predicted.rms if self.kind_of_mean == "rms" else geometric

    @property
    def beside_random(self) -> str:
        """The gain in words."""
        origin = f"the best of {self.experiment.motion.candidates} random motions"
        if self.random_predicted is None:
            return "no random motion within the limits was found for comparison"
        if self.gain is None:
            return f"{origin} does not identify all parameters"
        theirs = self.mean(self.random_predicted)
        return f"{self.gain:.2f} times smaller than that of {origin} ({theirs:.2%})"

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Parameters that the motion hardly excites."""
        poor = [
            name
            for name, relative in zip(self.predicted.names, self.predicted.relative, strict=True)
            if relative > 1
        ]
        return (diagnose("motion.uncertain", few(poor)),) if poor else ()


def excite(
    experiment: Experiment,
    watch: Watch = lambda done, total, best: None,
    prior: Array | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Excitation:
    """Design the motion of an experiment.

    Args:
        experiment: Says in `excitation` what is wanted, in `motion`, `measurement` and
            `identification` for which instrument.
        watch: Called after every step of a search, with the relative sigma of the best.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).
        interrupted: Asked after every step whether to go on with what there is.

    Raises:
        InfeasibleMotion: No motion inside the limits was found.
        ExperimentError: The band holds no motion.
    """
    tree = robot_of(experiment)
    wish = wish_of(experiment, tree, prior)
    pipeline = pipeline_of(experiment)
    one_sample = np.sqrt(pipeline.rate * pipeline.span)

    def relative(done: int, total: int, best: float) -> None:
        watch(done, total, float(np.exp(best / 2) / one_sample))

    with one_blas_thread():
        found = design(wish, relative, interrupted)
        forecast = forecaster(experiment, wish)
        random = _random(experiment, tree, wish.rules)
        return Excitation(
            experiment=experiment,
            tree=tree,
            rules=wish.rules,
            design=found,
            predicted=forecast(found.motion),
            random=random,
            random_predicted=None if random is None else forecast(random),
        )


def pipeline_of(experiment: Experiment) -> Pipeline:
    """What the experiment's estimates make of its recording."""
    rate = experiment.measurement.rate
    settings = experiment.identification.fitted(rate)
    sensed = experiment.measurement.senses_kinematics
    taps = 1 if sensed else motion_taps(rate, settings.position_low_pass).shape[1]
    if experiment.excitation.aim == "friction":
        weights, nearby = drive_filter(settings, rate)
    else:
        weights = row_weights(rate, settings.row_low_pass)
        nearby = reversal_samples(weights, settings.reversal_reach, rate)
    reach = taps // 2 + len(weights) // 2
    return Pipeline(
        rate=rate,
        span=max(experiment.motion.duration - 2 * reach / rate, 1 / rate),
        band=settings.row_low_pass or np.inf,
        resting=settings.deadband,
        reach=nearby / rate,
    )


def frequencies_of(experiment: Experiment) -> tuple[tuple[float, int], ...]:
    """Fundamentals and numbers of harmonics that are allowed.

    Args:
        experiment: Says the band in `excitation`, the duration in `motion`.

    Raises:
        ExperimentError: There are none.
    """
    table, duration = experiment.excitation, experiment.motion.duration
    lowest = max(table.lowest_frequency, 1 / duration)
    found = []
    for multiple in (2, 1, 4):  # faster ones are more informative, slower ones are richer
        fundamental = multiple * lowest
        harmonics = min(table.harmonics, int(table.highest_frequency / fundamental * (1 + 1e-9)))
        if harmonics >= min(FEWEST, table.harmonics):
            found.append((fundamental, harmonics))
    if not found:
        raise ExperimentError(
            f"no motion of {FEWEST} harmonics repeats at {lowest:g} Hz or more, at least once in "
            f"motion.duration = {duration:g} s, and stays below excitation.highest_frequency = "
            f"{table.highest_frequency:g} Hz; raise that, or the duration"
        )
    return tuple(found)


def wish_of(experiment: Experiment, tree: Tree, prior: Array | None = None) -> Wish:
    """What an experiment asks of a design.

    Args:
        experiment: Says so in `excitation` and other tables.
        tree: Its robot.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).

    Raises:
        ExperimentError: The band holds no motion, or the instruments do not show what is wanted.
    """
    table, about = experiment.excitation, experiment.robot.sensor
    if about and table.signals != "plate":
        raise ExperimentError(
            f"robot.sensor = {about!r} is designed for by its own rows alone: leave "
            'excitation.instrument "plate" and excitation.aim "bodies", or drop robot.sensor'
        )
    if table.aim == "friction" and tree.shafts:
        raise ExperimentError(
            "joints are held against the plate one by one, and robot.coupling joins some: leave "
            'excitation.aim "bodies"'
        )
    rules = rules_of(experiment, tree, designed=True)
    rows = _rows(experiment, tree, rules)
    pipeline = pipeline_of(experiment)
    torque = experiment.measurement.torque_noise or QUIET_TORQUE
    information = information_of(
        tree,
        rows,
        table.signals,
        plate_noise_of(experiment),
        np.full(tree.n, torque),
        table.judged_by,
        prior,
        friction_of(experiment),
        (pipeline.resting, pipeline.reach) if table.aim == "friction" else (0.0, 0.0),
    )
    share = 1 / (pipeline.rate * pipeline.span)  # of one sample
    information = replace(information, prior=information.prior * share)
    seconds = np.inf if table.seconds is None else table.seconds
    frequencies = frequencies_of(experiment)
    return Wish(rules, information, rows, frequencies, table.starts, seconds, experiment.seed)


def friction_of(experiment: Experiment) -> tuple[JointLaw, ...]:
    """Laws whose coefficients are wanted, the load's among them; () where bodies are."""
    if experiment.excitation.aim == "bodies":
        return ()
    laws = dict.fromkeys([*experiment.identification.laws, LOAD])
    return tuple(law for law in laws if not law.by or law.by in BY_LOAD)


def _rows(experiment: Experiment, tree: Tree, rules: Rules) -> dict[Model, SampledRows]:
    """Rows that the criterion and the limits look at."""
    wanted: set[Model] = {"reaction", *models_of(experiment.excitation.signals)}
    if np.isfinite(rules.limits.effort).any():
        wanted.add("dynamic")
    zeros = experiment.identification.zeros
    order: tuple[Model, ...] = ("reaction", "dynamic")
    found = {m: SampledRows(tree, minimal_set(tree, m, zeros=zeros)) for m in order if m in wanted}
    if experiment.robot.sensor:
        seen = experiment.sensed(tree, model_of(experiment))
        joints = [tree.index(name) for name in seen.names]
        found["reaction"] = SampledRows(seen, minimal_set(seen, "reaction"), joints)
    return found


def forecaster(experiment: Experiment, wish: Wish) -> Callable[[Fourier], Prediction]:
    """What any motion promises an experiment.

    Args:
        experiment: Says of what.
        wish: What it asks of a design.
    """
    joints = experiment.excitation.signals == "joints"
    names = wish.rows["dynamic" if joints else "reaction"].minimal.names
    if laws := friction_of(experiment):
        kinds = ("constant", *(law.kind for law in laws))
        names = tuple(f"{kind}/{joint}" for kind in kinds for joint in wish.rules.tree.names)
    pipeline = pipeline_of(experiment)

    def forecast(motion: Fourier) -> Prediction:
        return predict(wish.information, wish.rows, motion, pipeline, names)

    return forecast


def _random(experiment: Experiment, tree: Tree, rules: Rules) -> Fourier | None:
    """What the experiment would run without a design."""
    motion = experiment.motion.model_copy(update={"file": ""})
    try:
        return motion_of(experiment.model_copy(update={"motion": motion}), tree, rules)
    except TestbedError:
        return None


_HEAD = """\
# A motion, made by testbed {version}, excite.
# q_j(t) = offset + sum over k = 1, 2, ... of sine_k sin(k w t) + cosine_k cos(k w t),
# w = 2 pi fundamental; rad or m, joint side. To run it: file = "this file" under [motion].
"""


def write_motion(path: Path, found: Excitation) -> None:
    """Write a motion.

    Args:
        path: The file; what stands there is replaced.
        found: The motion, its proof, and what it promises.
    """
    design, predicted, tree = found.design, found.predicted, found.tree
    model, limits = Path(found.experiment.model), found.rules.limits
    motion = design.motion
    named = os.path.relpath(model.resolve(), path.resolve().parent)
    lines = [
        _HEAD.format(version=versions()["testbed"]),
        f"model = {json.dumps(Path(named).as_posix())}",
        f"model_sha256 = {json.dumps(fingerprint(model))}",
        f"fundamental = {motion.fundamental!r}  # Hz",
    ]
    for j, name in enumerate(tree.names):
        lines += ["", f"[joint.{json.dumps(name)}]", f"offset = {float(motion.offset[j])!r}"]
        lines += [f"sine = {_list(motion.sine[j])}", f"cosine = {_list(motion.cosine[j])}"]
    lines += ["", "[limits]  # rad or m, and per s, per s^2; N m or N"]
    lines += [f"{json.dumps(name)} = {_limit(limits, j)}" for j, name in enumerate(tree.names)]
    lines += ["", "[predicted]  # standard deviation of each parameter as a share of its value"]
    pairs = zip(predicted.names, predicted.relative, strict=True)
    lines += [f"{json.dumps(name)} = {float(share):.4g}" for name, share in pairs]
    for margin in design.proof.margins:
        lines += ["", "[[proof]]  # what is left of what may be used, at every moment"]
        lines += [f"limit = {json.dumps(margin.label)}", f"left = {margin.left:.6g}"]
        lines += [f'unit = "{margin.unit or "share"}"', f"instant = {margin.instant:.6g}  # s"]
    with replacing(path) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _list(values: Array) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _limit(limits: Limits, joint: int) -> str:
    low, high = float(limits.low[joint]), float(limits.high[joint])
    parts = [f"position = [{low!r}, {high!r}]", f"velocity = {float(limits.velocity[joint])!r}"]
    parts.append(f"acceleration = {float(limits.acceleration[joint])!r}")
    if np.isfinite(limits.effort[joint]):
        parts.append(f"effort = {float(limits.effort[joint])!r}")
    return "{ " + ", ".join(parts) + " }"


MOST_SAMPLES = 5e6
"""Of a file."""

_SIGNALS = {"position": "q", "velocity": "qd", "acceleration": "qdd"}


def write_trajectory(path: Path, found: Excitation, rate: float) -> RestToRest:
    """Write a motion's samples: columns time, position/JOINT, velocity/JOINT, acceleration/JOINT.

    Time is zero where the periodic motion begins: what is recorded from there on, whole periods,
    is for the estimate; what comes before leads from rest into it, what comes after to rest.

    Args:
        path: The file, .csv or .parquet; what stands there is replaced.
        found: The motion.
        rate: Samples a second [Hz].

    Returns:
        The motion with its start and end.

    Raises:
        ExperimentError: Neither of the two formats, or too many samples.
        InfeasibleMotion: The motion cannot begin from rest.
    """
    check_ending(path)
    tree, duration = found.tree, found.experiment.motion.duration
    motion = rest_to_rest(found.design.motion, found.rules, duration)
    length = motion.end + 2 * motion.start.duration
    if rate * length > MOST_SAMPLES:
        raise ExperimentError(
            f"{length:g} s at {rate:g} Hz are {rate * length:.1e} samples, more than "
            f"{MOST_SAMPLES:.0e}; choose a lower --rate or a shorter motion.duration"
        )
    samples = samples_of(motion, rate)
    units = {"time": "s"} | {
        f"{signal}/{joint.name}": UNITS[joint.kind][signal]
        for signal in _SIGNALS
        for joint in tree.joints
    }
    columns = _columns(samples, tree)
    with replacing(path) as fresh:
        if path.suffix.lower() == ".csv":
            _write_csv(fresh, columns)
        else:
            facts = {"robot": tree.name, "period": motion.period, "versions": versions()}
            write_table(fresh, units, facts, [columns])
    return motion


def check_ending(path: Path) -> None:
    """Whether samples can be written to a file.

    Args:
        path: The file.

    Raises:
        ExperimentError: Its ending is of neither format.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ExperimentError(f"'{path}': samples are written as .csv or .parquet")


def samples_of(motion: RestToRest, rate: float) -> Motion:
    """Samples from rest to rest; time is zero where the periodic motion begins.

    Args:
        motion: From rest to rest.
        rate: Samples a second [Hz].
    """
    lead = motion.start.duration
    first = -int(np.floor(lead * rate + 1e-9))
    last = int(np.floor((motion.end + lead) * rate + 1e-9))
    return motion.at(np.arange(first, last + 1) / rate)


def _columns(samples: Motion, tree: Tree) -> dict[str, Array]:
    found = {"time": samples.t}
    for signal, attribute in _SIGNALS.items():
        values: Array = getattr(samples, attribute)
        found |= {f"{signal}/{name}": values[:, j] for j, name in enumerate(tree.names)}
    return found


def _write_csv(path: Path, columns: dict[str, Array]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in np.column_stack(list(columns.values())):
            writer.writerow([repr(value) for value in row.tolist()])
