"""bedplate-bench: recordings for any tool, their truth kept apart, and a score of its answers.

`make` writes, for every case, `recordings/CASE/` (robot.urdf, recording.csv.gz, unseen.csv) and
`truth/CASE.json`. The bodies of robot.urdf are wrong by 15 % and 2 cm, as those of CAD are. Every
other draw is simulated by testbed, with MuJoCo's own dry friction in closed loop; the others are
Pinocchio's plain inverse dynamics. Noise and faults are added here.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import groupby, repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import typer
from scipy.signal import lfilter

import testbed as tb
from benchmarks import inverse_recordings
from benchmarks.fault_trials import trials
from benchmarks.inverse_recordings import inverse, on_a_free_base, real_robot
from benchmarks.lines import print_lines
from benchmarks.rivals.case import read
from testbed.core.base.arrays import Array
from testbed.core.recordings.recording import Recording, Truth
from testbed.lab.instruments.chain import Instrument
from testbed.motion.fourier import Fourier
from testbed.motion.limits import joint_limits
from tests.helpers.paths import ROOT

ROBOTS = {"puma": "puma562", "ur5": "ur5", "panda": "panda", "gantry": "gantry", "tree": "tree"}
"""Names here, and in `inverse_recordings`."""

NOISES = ("white", "coloured", "coarse")
"""White noise; of torques and plate an autoregression of 0.3 s; white, and encoders of 1e-3."""

FAULTS = {
    "constant": "torque of {} x 1.1",
    "late": "wrench 20 ms late",
    "turned": "plate turned 5 deg about x",
    "zero": "encoder of {} + 0.02",
    "saturated": "torque of {} saturated at half",
}
"""As `fault_trials` says it, of the second joint that turns."""

RATE, SECONDS = 500.0, 20.0
UNSEEN_RATE, UNSEEN_SECONDS = 50.0, 10.0

FAST = {"revolute": 1.5, "prismatic": 0.5}
"""Greatest speeds [rad/s, m/s]."""

FRICTION = 0.05
"""Dry friction, and viscous friction at 1 rad/s or m/s, over a joint's greatest force."""

TORQUE_NOISE = 0.01
"""Of a joint's greatest force."""

PLATE_NOISE = np.repeat([0.5, 0.1], 3)
"""[N, N m]."""

ENCODER, COARSE = 1e-4, 1e-3
"""Standard deviation and step of encoders, and the step of coarse ones [rad or m]."""

MEMORY = 0.3
"""Of coloured noise [s], nine tenths of it; the last tenth is white."""

NORMAL = 1.96


@dataclass(frozen=True)
class Case:
    """What a recording is of.

    Attributes:
        robot: One of `ROBOTS`.
        noise: One of `NOISES`.
        draw: Of bodies, motion and noise.
        fault: One of `FAULTS`, or "" for none.
    """

    robot: str
    noise: str
    draw: int
    fault: str = ""

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.robot}-{self.fault or self.noise}-{self.draw:02d}"


def cases(draws: int, every_fault: bool, robots: Sequence[str] = tuple(ROBOTS)) -> Iterator[Case]:
    """All that is recorded.

    Args:
        draws: Of every robot and noise.
        every_fault: At every robot, not one at each.
        robots: Which.
    """
    for place, robot in enumerate(ROBOTS):
        if robot in robots:
            yield from (Case(robot, noise, k) for noise in NOISES for k in range(draws))
            planted = [*FAULTS] if every_fault else [*FAULTS][place : place + 1]
            yield from (Case(robot, "white", 0, fault) for fault in planted)


def make(folder: Path, wanted: Sequence[Case], first: int = 0, jobs: int = 2) -> dict[str, Any]:
    """Write recordings and truth.

    Args:
        folder: Where; a new one.
        wanted: What.
        first: Seed of the first draw.
        jobs: Processes at a time.
    """
    (folder / "truth").mkdir(parents=True)

    def same(case: Case) -> tuple[str, int]:
        return case.robot, case.draw

    groups = [list(group) for _, group in groupby(sorted(wanted, key=same), same)]
    if jobs == 1:
        list(map(_make, repeat(folder), groups, repeat(first)))
    else:
        with ProcessPoolExecutor(jobs, get_context("spawn")) as processes:
            list(processes.map(_make, repeat(folder), groups, repeat(first)))
    size = sum(each.stat().st_size for each in folder.glob("recordings/*/*"))
    return {"cases": len(wanted), "megabytes": round(size / 1e6, 1)}


def _make(folder: Path, group: Sequence[Case], first: int) -> None:
    """Cases of one motion."""
    seed = first + group[0].draw
    happened = happen(folder, group[0].robot, seed)
    for case in group:
        _write(folder, case, happened, seed)


@dataclass(frozen=True, eq=False)
class Happened:
    """A motion of a real robot, and an unseen one.

    Attributes:
        urdf: What is handed out.
        tree: The same, read.
        t: Times, (M,) [s].
        q: Positions, (M, n) [rad or m].
        torque: With friction, (M, n) [N m or N].
        wrench: On the robot by the ground, (M, 6) [N, N m].
        unseen: Times, positions, velocities, accelerations of another motion, (m, 1 + 3 n).
        expected: Joint torques of that without friction, (m, n), and its wrench, (m, 6).
    """

    urdf: str
    tree: tb.Tree
    t: Array
    q: Array
    torque: Array
    wrench: Array
    unseen: Array
    expected: tuple[Array, Array]


def happen(folder: Path, robot: str, seed: int) -> Happened:
    """A robot, its motion, and what is unseen; the real URDF is kept with the truth.

    Args:
        folder: Of the set.
        robot: One of `ROBOTS`.
        seed: Of all of it.
    """
    rng = np.random.default_rng([seed, 9])
    given = inverse_recordings.ROBOTS[ROBOTS[robot]]
    urdf = _text(real_robot(*given, rng, 0.0, 0.0))
    real = real_robot(*given, rng, 0.15, 0.02)
    file = folder / f"truth/{robot}-{seed:02d}.urdf"
    file.write_text(urdf)
    tree = tb.load_tree(file)
    limits = joint_limits(tree, {joint.name: FAST[joint.kind] for joint in tree.joints})
    path, other = (tb.random_motion(tree, limits, 0.1, 5, rng) for _ in range(2))
    plain = on_a_free_base(real)
    t = np.arange(round(RATE * SECONDS)) / RATE
    seen, new = path.at(t), other.at(np.arange(UNSEEN_RATE * UNSEEN_SECONDS) / UNSEEN_RATE)
    expected = inverse(plain, tree.names, new.q, new.qd, new.qdd)
    unseen = np.column_stack([new.t, new.q, new.qd, new.qdd])
    q = seen.q
    torque, wrench = inverse(plain, tree.names, q, seen.qd, seen.qdd)
    friction = FRICTION * np.abs(torque).max(axis=0)
    _with_friction(real, dict(zip(tree.names, friction, strict=True)))
    file.write_text(_text(real))
    torque = torque + friction * (np.sign(seen.qd) + seen.qd)
    if not seed % 2:
        made = simulated(file, path, SECONDS)
        q, torque, wrench = made.position, made.torque, made.wrench
    return Happened(urdf, tree, t, q, torque, wrench, unseen, expected)


def simulated(model: Path, path: Fourier, seconds: float) -> Truth:
    """What happens along a motion, by testbed: in closed loop, with MuJoCo's own dry friction.

    Args:
        model: The real robot.
        path: The motion.
        seconds: Of it.
    """
    lasting = [f"motion.duration={seconds}"]
    table6 = tb.Experiment.from_toml(ROOT / "experiments/table6.toml", lasting)
    changed = {"model": str(model), "measurement": Instrument(rate=RATE)}
    made = tb.record(table6.model_copy(update=changed), motion=path).truth
    assert made is not None
    return made


def _text(robot: ElementTree.Element) -> str:
    return ElementTree.tostring(robot, encoding="unicode")


def _with_friction(robot: ElementTree.Element, friction: Mapping[str, float]) -> None:
    for joint in robot.iterfind("joint"):
        for stated in joint.findall("dynamics"):
            joint.remove(stated)
        value = friction.get(str(joint.get("name")))
        if value is not None:
            ElementTree.SubElement(joint, "dynamics", friction=str(value), damping=str(value))


def _write(folder: Path, case: Case, made: Happened, seed: int) -> None:
    """A case's recording and truth."""
    recording = measured(case, made, seed)
    place = folder / "recordings" / case.name
    place.mkdir(parents=True)
    (place / "robot.urdf").write_text(made.urdf)
    names = made.tree.names
    signals = ["t", *(f"{kind}_{name}" for kind in ("q", "tau") for name in names), *CHANNELS]
    forces = recording.measured("torque"), recording.measured("wrench")
    columns = [recording.time, recording.position, *forces]
    with gzip.GzipFile(place / "recording.csv.gz", "wb", GZIP, mtime=0) as file:
        _table(file, signals, np.column_stack(columns), "%.6g")
    states = ["t", *(f"{kind}_{name}" for kind in ("q", "qd", "qdd") for name in names)]
    _table(place / "unseen.csv", states, made.unseen, "%.9g")
    torque, wrench = made.expected
    truth = vars(case) | {"torque": torque.tolist(), "wrench": wrench.tolist()}
    (folder / f"truth/{case.name}.json").write_text(json.dumps(truth))


def _table(file: Any, names: Sequence[str], values: Array, digits: str) -> None:
    np.savetxt(file, values, digits, ",", header=",".join(names), comments="")


GZIP = 5
"""Level: a hundredth larger than the best, in a third of its time."""

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")


def measured(case: Case, made: Happened, seed: int) -> Recording:
    """What encoders, drives and plate show.

    Args:
        case: Which noise and fault.
        made: What happens.
        seed: Of the noise.
    """
    rng = np.random.default_rng([seed, 10 + NOISES.index(case.noise)])

    def noise(size: Array) -> Array:
        white = rng.normal(size=(len(made.t), len(size)))
        if case.noise == "coloured":
            kept = np.exp(-1 / (RATE * MEMORY))
            slow = lfilter([np.sqrt(1 - kept**2)], [1, -kept], rng.normal(size=white.shape), axis=0)
            white = 0.1 * white + 0.9 * slow
        return size * white

    step = COARSE if case.noise == "coarse" else ENCODER
    q = made.q + ENCODER * rng.normal(size=made.q.shape)
    recording = Recording(
        made.tree.names,
        made.t,
        step * np.round(q / step),
        made.torque + noise(TORQUE_NOISE * np.abs(made.torque).max(axis=0)),
        made.wrench + noise(PLATE_NOISE),
        tare=np.zeros(6),
    )
    if not case.fault:
        return recording
    name = [joint.name for joint in made.tree.joints if joint.revolute][1]
    change = FAULTS[case.fault].format(name)
    return next(each for each in trials(made.tree) if each.fault == change).change(recording)


def score(folder: Path, answers: Mapping[str, Any]) -> dict[str, Any]:
    """How well a tool has answered.

    Args:
        folder: Of the set.
        answers: By case: "torque", (m, n), without friction, as the recorded torques alone have
            it, and "wrench", (m, 6), by the plate alone, along the unseen motion; or "parameters"
            by joint: mass, its moments, Ixx, Ixy, Iyy, Ixz, Iyz, Izz of what the joint moves, in
            the frame of its child link. Besides, as they are known: "torque_sigma",
            "wrench_sigma"; "said", words of warning; "cpu", seconds by signal. In place of a
            prediction "torque_expected", "wrench_expected": its error's standard deviation.

    Returns:
        Errors, rms over rms (of the wrench about its mean), rms over draws, and shares of
        intervals of 95 % that hold the truth, by signal, robot and noise; which faults raised words
        that the same recording without the fault did not; CPU times.
    """
    errors: dict[str, dict[str, list[float]]] = {"torque": {}, "wrench": {}}
    held: dict[str, dict[str, list[float]]] = {"torque": {}, "wrench": {}}
    cpu: dict[str, list[float]] = {"torque": [], "wrench": []}
    noticed: list[str] = []
    missed: list[str] = []
    for name, answer in answers.items():
        truth = json.loads((folder / f"truth/{name}.json").read_text())
        if truth["fault"]:
            clean = Case(truth["robot"], "white", truth["draw"]).name
            new = set(answer.get("said", ())) - set(answers.get(clean, {}).get("said", ()))
            (noticed if new else missed).append(name)
            continue
        cell = f"{truth['robot']} {truth['noise']}"
        found = dict(answer)
        if "parameters" in answer:
            found |= _predicted(folder / "recordings" / name, answer["parameters"])
        for signal in ("torque", "wrench"):
            true = np.array(truth[signal])
            if f"{signal}_expected" in found:
                off = np.array(found[f"{signal}_expected"])
            elif signal in found:
                off = np.array(found[signal]) - true
            else:
                continue
            about = true - true.mean(axis=0) * (signal == "wrench")
            errors[signal].setdefault(cell, []).append(float(_rms(off) / _rms(about)))
            sigma = found.get(f"{signal}_sigma")
            if sigma is not None:
                inside = np.abs(off) < NORMAL * np.array(sigma)
                held[signal].setdefault(cell, []).append(float(inside.mean()))
            if "cpu" in answer:
                cpu[signal].append(answer["cpu"][signal])
    return {
        "error": {s: {c: _rms(np.array(e)) for c, e in by.items()} for s, by in errors.items()},
        "coverage": {s: {c: float(np.mean(e)) for c, e in by.items()} for s, by in held.items()},
        "cases": {s: sum(map(len, by.values())) for s, by in errors.items()},
        "noticed": noticed,
        "missed": missed,
        "cpu": {s: float(np.median(e)) for s, e in cpu.items() if e},
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _predicted(place: Path, parameters: Mapping[str, Sequence[float]]) -> dict[str, Array]:
    """Torques and wrenches of bodies along the unseen motion, by Pinocchio."""
    model = on_a_free_base(ElementTree.parse(place / "robot.urdf").getroot())
    given = read(place)
    bodies = np.zeros((model.njoints - 1, 10))
    for name, values in parameters.items():
        bodies[model.getJointId(name) - 1] = values

    def law(*state: Any) -> Array:
        return np.asarray(pin.computeJointTorqueRegressor(*state) @ bodies.ravel())

    torque, wrench = inverse(model, given.joints, *given.unseen, law)
    return {"torque": torque, "wrench": wrench}


main = typer.Typer(no_args_is_help=True, help="Recordings for any tool, and a score of answers.")


@main.command("make")
def make_set(
    folder: Annotated[Path, typer.Argument(help="A new folder.")],
    draws: Annotated[int, typer.Option(min=1, help="Of every robot and noise.")] = 1,
    first: Annotated[int, typer.Option(min=0, help="Seed of the first draw.")] = 0,
    every_fault: Annotated[bool, typer.Option("--every-fault", help="At every robot.")] = False,
) -> None:
    """Write recordings, and apart from them their truth: docs/rivals.md."""
    print_lines([make(folder, list(cases(draws, every_fault)), first)])


@main.command("score")
def score_answers(
    folder: Annotated[Path, typer.Argument(help="Of `make`.")],
    answers: Annotated[Path, typer.Argument(help="JSON of a tool's answers.")],
) -> None:
    """Errors, coverage and faults noticed of a tool's answers."""
    print_lines([score(folder, json.loads(answers.read_text()))])
