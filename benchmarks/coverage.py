"""How often intervals of 95 % hold the truth, and faults of an instrument are told.

Motions are random ones, inside the robot's limits, or the best of forty; signals are those of
rigid bodies with dry and viscous friction, simulated where the joints' torques are asked for.
A humanoid squats, or hangs in the air with a force sensor in its hip; its wrench is Pinocchio's.
Every seed is another motion and other noise.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Annotated, Any

import numpy as np
import typer
from scipy import stats

import testbed as tb
from benchmarks import random_recordings
from benchmarks.lines import print_lines
from benchmarks.random_recordings import NOISES, ROBOTS, SPEEDS, instrument
from testbed.core.base.arrays import Array
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.views import adapt_to_robot
from testbed.core.robot.force_sensor import ForceSensor, tree_beyond_sensor
from testbed.core.robot.free_root import with_free_base
from testbed.core.robot.model_file import ModelFile
from testbed.sensors.sensor_error import SensorError
from tests.helpers.humanoid import G1, humanoid
from tests.helpers.paths import ROOT

SHOWN = ("puma", "ur5", "gantry_ppp_rrr")
"""Of ROBOTS."""

NORMAL = 1.96

LEAST = 0.93
"""Share of all intervals that must hold the truth, but for two standard errors."""

FALSE_ALARMS = 0.01
"""Largest share of clean recordings about which something is said, of all kinds together.

Of one kind 20 runs tell no share of 1 %: it fails where its interval of 95 % leaves the goal out.
"""

POWER = 0.99
"""Least share of faulty recordings about which something is said, judged likewise."""

COARSE = (tb.EncoderResolution(count=1e-3),)
"""Encoders that stand still from sample to sample in slow motions."""

HIP = "left_hip_pitch_joint"


@dataclass(frozen=True)
class Study:
    """What is repeated.

    Attributes:
        kind: "clean", "torques", "coarse", the humanoid's, or a fault in words.
        robot: One of ROBOTS, or "g1".
        motion: One of SPEEDS, or "chosen": the best of forty.
        noise: One of NOISES: the plate's; joints' torques have white noise always.
        method: Whose sigmas.
        faults: Of the instrument.
        right: The kind of nuisance that should be named.
        goal: Largest share of alarms for a clean recording, least for a faulty one.
    """

    kind: str
    robot: str
    motion: str = "default"
    noise: str = "white"
    method: Signal = "wrench"
    faults: tuple[SensorError, ...] = ()
    right: str = ""
    goal: float = FALSE_ALARMS

    @property
    def words(self) -> str:
        """By which it is picked."""
        fault = ("fault",) * bool(self.right)
        return " ".join([*fault, self.kind, self.robot, self.motion, self.noise, self.method])

    @cached_property
    def tree(self) -> tb.Tree:
        """The robot; a humanoid's base moves."""
        if self.robot != "g1":
            return tb.load_tree(ROBOTS[self.robot])
        model = ModelFile(G1, weld_root=True)
        free, tree = with_free_base(model.tree()), model.tree()
        if self.kind != "hip in the air":
            return free
        sensor = ForceSensor(tree.joints[tree.index(HIP)].body)
        return tree_beyond_sensor(free, model.links(), sensor)

    def recorded(self, seed: int, seconds: float) -> Recording:
        """A recording of a motion of its own; the humanoid's are twice as long, at 50 Hz.

        Args:
            seed: Of motion and noise.
            seconds: Duration.
        """
        if self.robot == "g1":
            joint = HIP if self.kind == "hip in the air" else ""
            return adapt_to_robot(humanoid(2 * seconds, 50.0, seed, 1.0, joint)[1], self.tree)
        if self.method == "wrench":
            kind = (self.motion, self.noise, seconds)
            return random_recordings.recorded(self.tree, *kind, seed, self.faults)
        settings = [f"seed={seed}", f"motion.duration={seconds}"]
        settings += ["motion.candidates=1"] * (self.motion != "chosen")
        speed = SPEEDS.get(self.motion)
        if speed is not None:
            listed = ",".join(f'"{name}"={speed}' for name in self.tree.names)
            settings.append(f"motion.max_velocity={{{listed}}}")
        experiment = tb.Experiment.from_toml(ROOT / "experiments/table6.toml", settings)
        changed = {"model": str(ROBOTS[self.robot]), "measurement": instrument(self.noise)}
        return tb.record(experiment.model_copy(update=changed)).blind()


def studies() -> Iterator[Study]:
    """All that docs/uncertainty.md shows, and the humanoid."""
    for robot, motion, noise in product(SHOWN, SPEEDS, NOISES):
        yield Study("clean", robot, motion, noise)
    for motion in (*SPEEDS, "chosen"):
        yield Study("torques", "puma", motion, method="torque")
    for robot, noise in (("puma", "white"), ("puma", "ar .3 s"), ("ur5", "ar .3 s")):
        yield Study("coarse", robot, "slow", noise, faults=COARSE)
    yield from (Study(kind, "g1") for kind in ("squatting", "hip in the air"))
    for robot in SHOWN:
        second = tb.load_tree(ROBOTS[robot]).names[1]
        for fault, what, right, goal in (
            ("skew 1 ms", tb.PlateDelay(delay=1e-3), "skew", POWER),
            ("skew .2 ms", tb.PlateDelay(delay=2e-4), "skew", 0.95),
            ("crosstalk 1 %", tb.PlateCrosstalk(size=0.01), "crosstalk", POWER),
            ("pose .2 deg, 1 mm", tb.PlatePose(rotation=3.5e-3, translation=1e-3), "pose", POWER),
            ("Fz x 1.05", tb.PlateGain(error=(0.0, 0.0, 0.05, 0.0, 0.0, 0.0)), "gains", POWER),
            ("encoder 2 x 1.01", tb.EncoderGain(error={second: 0.01}), "encoder_gains", POWER),
            ("lag 5 ms", tb.PlateDelay(delay=5e-3), "skew", POWER),
            ("filter 45 Hz, 5 ms", tb.PlateAntiAliasFilter(cutoff=45.0), "skew", POWER),
        ):
            yield Study(fault, robot, faults=(what,), right=right, goal=goal)


@dataclass(frozen=True, eq=False)
class Seen:
    """What is kept of one estimate, which itself holds its recording.

    Attributes:
        names: Of the parameters.
        z: Their errors in sigmas.
        bodies: How many of them are bodies'.
        causes: Families of model errors, the clearest first; none where there are none.
        doubtful: Whether sigma may be wrong.
        steps: Whether encoders' steps matter.
        others: Whether other faults are told.
    """

    names: tuple[str, ...]
    z: Array
    bodies: int
    causes: tuple[tuple[str, ...], ...]
    doubtful: bool
    steps: bool
    others: bool


def seen(study: Study, seed: int, seconds: float) -> Seen:
    """One recording's estimate beside the truth."""
    tree, settings = study.tree, tb.Settings(zeros=study.robot == "puma")
    found = tb.identify(tree, study.recorded(seed, seconds), study.method, settings=settings)
    theta, drives = tb.barycentric(tree), found.drives
    truth = found.minimal.values(theta) if drives is None else drives.values(theta, tree)
    families = tuple(each.family for each in found.model_errors)
    causes = (families,) if families else ()
    errors = sum(each.level == "error" for each in found.diagnostics)
    steps = found.noise is not None and found.noise.quantization_matters
    return Seen(
        found.names, (found.values - truth) / found.sigma, found.minimal.count, causes,
        found.has_errors, steps, errors > 0,
    )  # fmt: skip


def repeated(study: Study, first: int, runs: int, seconds: float) -> dict[str, Any]:
    """What is said of recordings, and where no fault is planted how intervals hold."""
    start = time.process_time()
    every = [seen(study, seed, seconds) for seed in range(first, first + runs)]
    said = [causes for each in every for causes in each.causes]
    alarms = alarmed(len(said), runs)
    low, high = alarms["interval"]
    reached = high >= study.goal if study.right else low <= study.goal
    line: dict[str, Any] = {
        **{key: getattr(study, key) for key in ("kind", "robot", "motion", "noise", "method")},
        "seconds": seconds,
        "seeds": f"{first} to {first + runs - 1}",
        **alarms,
        "goal": study.goal,
        "held": reached or not (study.right or study.kind == "clean"),
        "named_otherwise": sorted({causes[0] for causes in said} - {study.right}),
        "findings": _share(np.mean([each.doubtful for each in every])),
        "coarse_encoders": _share(np.mean([each.steps for each in every])),
        "other_findings": _share(np.mean([each.others for each in every])),
        "cpu_seconds": round((time.process_time() - start) / runs, 2),
    }
    if not study.right:
        held = intervals(every, study.method)
        return line | held | {"held": line["held"] and held["held"]}
    if said:
        line["named_first"] = _share(np.mean([causes[0] == study.right for causes in said]))
        line["named"] = _share(np.mean([study.right in causes for causes in said]))
    return line


def alarmed(alarms: int, runs: int) -> dict[str, Any]:
    """A share and its interval of 95 %."""
    interval = stats.binomtest(alarms, runs).proportion_ci(method="exact")
    held = [_share(interval.low), _share(interval.high)]
    return {"runs": runs, "alarms": _share(alarms / runs), "interval": held}


def intervals(every: list[Seen], method: Signal) -> dict[str, Any]:
    """Shares of 95 % intervals that hold the truth; the total mass apart."""
    z = np.abs([each.z for each in every])
    names, bodies = np.array(every[-1].names), every[-1].bodies
    inside, mass = z < NORMAL, np.char.startswith(names, "mbar")
    each = inside.mean(axis=0)
    kept = each[~mass]
    bound = 2 * inside[:, ~mass].mean(axis=1).std(ddof=1) / np.sqrt(len(every))
    line: dict[str, Any] = {
        "coverage": _share(kept.mean()),
        "bound": _share(bound),
        "held": bool(kept.mean() + bound >= LEAST),
        "worst": _share(kept.min()),
        "worst_parameter": names[~mass][kept.argmin()],
        "total_mass": _share(each[mass].mean()) if mass.any() else None,
        "parameters": len(names),
        "coverage_of_all": _share(inside.mean()),
        "within_3": _share(np.mean(z <= 3)),
        "rms_z": _share(np.sqrt(np.mean(np.square(z)))),
        "largest_z, median and most": [_share(f(z.max(axis=1))) for f in (np.median, np.max)],
    }
    if method == "torque":
        line |= {"bodies": _share(each[:bodies].mean()), "friction": _share(each[bodies:].mean())}
    return line


def total(clean: list[dict[str, Any]]) -> dict[str, Any]:
    """All clean recordings together."""
    runs = sum(line["runs"] for line in clean)
    alarms = round(sum(line["alarms"] * line["runs"] for line in clean))
    held = alarms <= FALSE_ALARMS * runs
    return {"kind": "all clean ones", **alarmed(alarms, runs), "goal": FALSE_ALARMS, "held": held}


def _share(value: Any) -> float:
    return round(float(value), 4)


def main(
    runs: Annotated[int, typer.Option(min=2, help="Recordings of each kind.")] = 200,
    first: Annotated[int, typer.Option(help="The first seed.")] = 5000,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 20.0,
    only: Annotated[list[str] | None, typer.Option(help="Studies whose words hold one.")] = None,
) -> None:
    """Coverage of intervals, false alarms, power: docs/uncertainty.md; exit code 1 below a goal."""
    asked = [study for study in studies() if any(word in study.words for word in only or [""])]
    lines = print_lines(repeated(study, first, runs, seconds) for study in asked)
    clean = [line for line in lines if line["kind"] == "clean"]
    lines += print_lines([total(clean)] if clean else [])
    raise typer.Exit(int(not all(line["held"] for line in lines)))
