"""Minimal sets: how the cost grows, and whether three witnesses agree on many trees."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

import testbed as tb
from benchmarks.lines import print_lines
from testbed.core.dynamics.rank_check import verify_drive_set, verify_minimal_set
from testbed.core.parameters.joint_terms import with_joint_terms
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.symbols import parameter_names
from testbed.core.robot.force_sensor import ForceSensor, tree_beyond_sensor
from testbed.core.robot.free_root import with_free_base
from testbed.core.robot.friction import JOINT_LAWS
from testbed.core.robot.model_file import ModelFile, mimic_joints
from testbed.core.robot.tree import Tree
from tests.helpers.paths import REAL
from tests.helpers.robots import random_robot, with_zeros

JOINTS = (10, 25, 50, 100, 200, 400)
RUNS = 5
GRAVITIES = {"down": (0.0, 0.0, -9.81), "tilted": (2.97, -4.95, -7.93), "off": (0.0, 0.0, 0.0)}


def scaling() -> dict[str, Any]:
    """Least time for both sets with all formulas, over the number of joints [s]."""
    times = []
    for n in JOINTS:
        tree = random_robot(np.random.default_rng(n), n).tree()
        runs = []
        for _ in range(RUNS):
            start = time.perf_counter()
            for each in (tb.minimal_set(tree, "torque"), tb.minimal_set(tree, "wrench")):
                assert each.formulas
            runs.append(time.perf_counter() - start)
        times.append(min(runs))
        print(f"{n:4d} joints {times[-1] * 1e3:8.1f} ms")
    exponent = float(np.polyfit(np.log(JOINTS), np.log(times), 1)[0])
    print(f"cost grows with the number of joints to the power {exponent:.2f}")
    return {"benchmark": "minimal", "joints": JOINTS, "seconds": times, "exponent": exponent}


def agreement(trees: int, zeros: bool) -> dict[str, Any]:
    """Rules, recursion and sampled regressor on random trees of 1 to 12 joints.

    Args:
        trees: How many.
        zeros: Of bodies with exact zeros, taken as known: the file's, and lists of any names;
            then gravity is one by turns, else all.
    """
    tally, every = Tally(), tuple(GRAVITIES.values())
    for seed in range(trees):
        rng = np.random.default_rng(seed)
        robot = random_robot(rng, int(rng.integers(1, 13)))
        tree = (with_zeros(rng, robot) if zeros else robot).tree()
        share = rng.choice([0.1, 0.5, 0.9])
        listed = [name for name in parameter_names(tree) if rng.random() < share]
        for gravity in every[seed % 3 : seed % 3 + 1] if zeros else every:
            for known in (True, listed) if zeros else (False,):
                tally.examine(f"tree {seed}", tree, gravity, known)
    return tally.said(f"{trees} trees") | {"benchmark": "agreement", "trees": trees, "zeros": zeros}


def _real() -> Iterator[tuple[str, ModelFile, Tree]]:
    """The robots of the package example-robot-data; roots welded, followers held."""
    for path in sorted(REAL.rglob("*.urdf")):
        try:
            model = ModelFile(path, weld_root=True, lock=dict.fromkeys(mimic_joints(path)))
            yield path.name, model, model.tree()
        except tb.TestbedError:  # refused with a reason, as tests/parameters checks
            continue


def real_robots(zeros: bool) -> dict[str, Any]:
    """The same on real robots."""
    tally, read = Tally(), 0
    for name, _, tree in _real():
        read += 1
        tally.examine(name, tree, tree.gravity, zeros)
    return tally.said(f"{read} robots") | {"benchmark": "robots", "robots": read, "zeros": zeros}


def force_sensors() -> dict[str, Any]:
    """Force sensors at all joints of those robots, on welded roots and on roots that move."""
    tally, read, rng = Tally(), 0, np.random.default_rng(42)
    for name, model, tree in _real():
        read, links = read + 1, model.links()
        for joint in tree.joints:
            place, turn = rng.uniform(-0.3, 0.3, 3), Rotation.random(rng=rng).as_matrix()
            sensor = ForceSensor(joint.body, place, turn)
            for base, tared in product((tree, with_free_base(tree)), (False, True)):
                cut = tree_beyond_sensor(base, links, sensor)
                minimal = tb.minimal_set(cut, "wrench", tared=tared)
                tally.compare(f"{name}, {joint.name}", cut, minimal)
    said = tally.said(f"force sensors in {read} robots")
    return said | {"benchmark": "cuts", "robots": read}


@dataclass
class Tally:
    """What has been checked, and the worst that was found."""

    checked: int = 0
    failed: int = 0
    worst: dict[str, float] = field(default_factory=dict)

    def examine(
        self, name: str, tree: Tree, gravity: ArrayLike, zeros: bool | Sequence[str]
    ) -> None:
        """Both models, the tared plate, S between them, and the drives."""
        dynamic = tb.minimal_set(tree, "torque", gravity, zeros)
        plates = [tb.minimal_set(tree, "wrench", gravity, zeros, tared=t) for t in (False, True)]
        for plate in plates:
            s = tb.selection(dynamic, plate)
            self.count(f"{name}: S", s.shape == (dynamic.count, plate.count))
        for minimal in (dynamic, *plates):
            self.compare(name, tree, minimal)
        for laws in (("rotor",), JOINT_LAWS):
            drives = verify_drive_set(tree, with_joint_terms(tree, dynamic, laws))
            self.count(f"{name}: {drives}", drives.agrees)
            self.largest("drives_change", drives.change)

    def compare(self, name: str, tree: Tree, minimal: MinimalSet) -> None:
        """One set by all witnesses."""
        found = verify_minimal_set(tree, minimal)
        alone = not minimal.lift[minimal.known_zero.ravel()].any()
        self.count(f"{name}: {found}", found.agrees and alone)
        for field_name in ("recursion_distance", "sampled_distance", "change", "inverse"):
            self.largest(field_name, getattr(found, field_name))

    def count(self, what: str, holds: bool) -> None:
        """One more check; said if it fails."""
        self.checked += 1
        self.failed += not holds
        if not holds:
            print(f"DISAGREE {what}")

    def largest(self, name: str, value: float) -> None:
        """Keep the largest value of a kind."""
        self.worst[name] = max(self.worst.get(name, 0.0), value)

    def said(self, of: str) -> dict[str, Any]:
        """Print what came of it."""
        print(f"{self.checked} checks of {of}: {self.failed} disagreements")
        return {"checks": self.checked, "disagreements": self.failed, "largest": self.worst}


def main(
    trees: Annotated[int, typer.Option(help="Random trees to verify besides.")] = 0,
    robots: Annotated[bool, typer.Option("--robots", help="Verify example-robot-data.")] = False,
    cuts: Annotated[bool, typer.Option("--cuts", help="Verify force sensors there.")] = False,
    zeros: Annotated[bool, typer.Option("--zeros", help="Take zero parameters as known.")] = False,
) -> None:
    """Cost of a minimal set over joints; asked, witnesses: exit code 1 if they disagree."""
    print_lines([scaling()])
    checks = [(trees, partial(agreement, trees, zeros)), (robots, partial(real_robots, zeros))]
    checks += [(cuts, partial(force_sensors))]
    lines = print_lines(check() for asked, check in checks if asked)
    raise typer.Exit(int(any(line["disagreements"] for line in lines)))
