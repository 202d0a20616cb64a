"""Generated equations: their length and cost beside other generators' published figures.

Rivals were measured elsewhere on a PUMA 560 of six joints with general bodies: OpenSYMORO and
SymPyBotics generating code for the minimal set; ROBOTRAN by the headers of its own output.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.arms import load, robots
from benchmarks.lines import print_lines
from benchmarks.regressor import LOOP, cases
from benchmarks.timing import least
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.tree import Joint
from testbed.equations.equations import Equations, equations
from testbed.equations.languages import write_equations
from tests.helpers.generated import python_module

RIVALS: dict[str, dict[str, Any]] = {
    "joint-forces": {"OpenSYMORO": "319 * 266 +", "SymPyBotics": "503 * 401 +"},
    "torque-regressor": {"OpenSYMORO": "1323 * 749 +"},
    "process [s]": {"OpenSYMORO": "0.58-0.75", "SymPyBotics": "16-25"},
    "operations a joint, 31 joints": {"ROBOTRAN": 4310 / 31},
}
GROWTH = (10, 20, 40, 70, 100)


def puma() -> dict[str, Any]:
    """Operations for the PUMA 560, and the time of a whole process that writes its regressor."""
    tree = load(robots()["puma6"])
    line: dict[str, Any] = {"bench": "equations of the PUMA 560, recursive, minimal set"}
    for each in equations(tree, ["joint-forces", "torque-regressor"], "recursive").equations:
        name = each.kind.name
        line[name] = {"testbed": _count(each), **RIVALS[name]}
    line["process [s]"] = {"testbed": round(_process(), 2), **RIVALS["process [s]"]}
    return line


def trees() -> dict[str, Any]:
    """Operations a joint of large trees, and what they take to write."""
    humanoid = load(robots()["tree30"])
    found: dict[str, Any] = {"bench": "equations of trees of 30 joints, recursive"}
    for name, tree in (("axes along the bodies'", squared(humanoid)), ("oblique", humanoid)):
        start = time.thread_time()
        (each,) = equations(tree, form="recursive").equations
        seconds = time.thread_time() - start
        count = each.program.count
        operations = (count.multiplications + count.additions) / tree.n
        found[name] = {"operations a joint": round(operations, 1), "seconds": round(seconds, 2)}
    return found | RIVALS["operations a joint, 31 joints"]


def growth() -> dict[str, Any]:
    """Cost of writing the recursive form over the number of joints."""
    tasks = {str(n): partial(equations, chain(n), form="recursive") for n in GROWTH}
    seconds = least(tasks, 5)
    times = np.array([seconds[str(n)] for n in GROWTH])
    exponent = float(np.polyfit(np.log(GROWTH), np.log(times), 1)[0])
    counts = [equations(chain(n), form="recursive").equations[0].program.count for n in GROWTH]
    each = [(c.multiplications + c.additions) / n for c, n in zip(counts, GROWTH, strict=True)]
    return {
        "bench": "cost of the recursive form",
        "joints": GROWTH,
        "seconds": [round(t, 3) for t in times],
        "exponent": round(exponent, 2),
        "operations a joint": [round(x, 1) for x in each],
    }


def speed(rounds: int) -> dict[str, Any]:
    """Generated NumPy code on 1e5 samples against Pinocchio's regressor in a loop."""
    case = next(case for case in cases() if case.name == "puma6")
    kinds = ["torque-regressor", "wrench-regressor"]
    text = write_equations(equations(case.tree, kinds, "recursive"), "python")
    with tempfile.TemporaryDirectory() as folder:
        module = python_module(text, Path(folder))
    rng, samples = np.random.default_rng(0), 100_000
    q, qd, qdd = rng.uniform(-2, 2, (3, samples, case.tree.n))
    line: dict[str, Any] = {"bench": "generated Python against a Pinocchio loop, ratio"}
    for model in ("torque", "wrench"):
        function = getattr(module, f"{model}_regressor")
        tasks = {"loop": case.loop(model), "generated": partial(function, q, qd, qdd)}
        best = least(tasks, rounds)
        line[model] = round((best["loop"] / LOOP) / (best["generated"] / samples), 1)
    return line


def squared(tree: tb.Tree) -> tb.Tree:
    """The tree with all frames parallel at q = 0 and axes along them."""
    joints = tuple(
        replace(joint, rotation=np.eye(3), axis=np.eye(3)[int(np.argmax(np.abs(joint.axis)))])
        for joint in tree.joints
    )
    return replace(tree, joints=joints)


def chain(n: int) -> tb.Tree:
    """A chain whose axes go round x, y, z, with offsets in all directions."""
    rng = np.random.default_rng(0)
    body = Inertia.about_centre(1.0, [0.1, 0.1, 0.1], np.eye(3))
    joints = [
        Joint(f"j{k}", f"b{k}", "revolute", k - 1, np.eye(3)[k % 3], offset, np.eye(3))
        for k, offset in enumerate(rng.uniform(-0.3, 0.3, (n, 3)))
    ]
    return tb.Tree("chain", tuple(joints), (body,) * n)


def _process(rounds: int = 10) -> float:
    """Least time of `testbed equations` for the minimal regressor, from start to end."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "puma.urdf").write_text(robots()["puma6"])
        words = ["equations", "puma.urdf", "--what", "torque-regressor", "--form", "recursive"]
        command = [sys.executable, "-m", "testbed", *words, "--out", "regressor.py", "--force"]

        def run() -> None:
            subprocess.run([*command, "--language", "python"], cwd=folder, check=True)

        return least({"process": run}, rounds, wall=True)["process"]


def _count(each: Equations) -> str:
    count = each.program.count
    return f"{count.multiplications} * {count.additions} +"


def main(rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 10) -> None:
    """Operations and cost of generated equations beside other generators'."""
    print_lines(measure() for measure in (puma, trees, growth, partial(speed, rounds)))
