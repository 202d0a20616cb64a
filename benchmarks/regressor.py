"""Rows and fits against what users do today: Pinocchio in a Python loop, then lstsq."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
import typer

import testbed as tb
from benchmarks.arms import load, robots
from benchmarks.lines import print_lines
from benchmarks.timing import least, peak_flops, peak_rss
from testbed.core.base.arrays import Array
from testbed.core.kernel import numba_engine
from testbed.core.kernel.layout import Layout, make_layout
from testbed.core.kernel.records import SignalWindow
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.recording import Recording

SAMPLES = 16_384
"""A window of the identification."""
LOOP = 300
"""Samples of a Pinocchio loop: the same each, so that few are enough."""

MODELS: tuple[Signal, ...] = "torque", "wrench"

STACK = {"arm3": 4000, "puma6": 4000, "tree30": 900}
"""Samples of an lstsq problem."""

# Vector operations of the kernel's functions, a multiplication with an addition counted as one.
LINK, SINE, CARRY, INCLINED, PUSH, HERE = 53, 32, 47, 8, 14, 4


@dataclass(frozen=True)
class Case:
    """One robot, its samples, and the loop of its users."""

    name: str
    tree: tb.Tree
    urdf: str
    recording: Recording

    def signals(self, found: Layout) -> SignalWindow:
        """All samples, unfiltered, their kinematics sensed."""
        r = self.recording
        assert r.velocity is not None
        assert r.acceleration is not None
        unit = np.array([[1.0], [0.0], [0.0]])
        measured = r.measured("torque") if found.model == "torque" else r.measured("wrench")
        moving = r.position, r.velocity, r.acceleration
        return SignalWindow(*moving, measured, unit, np.ones(1), 0.0, 0, 0, 1, r.samples)

    def loop(self, model: Signal, samples: int = LOOP) -> Any:
        """`computeJointTorqueRegressor` sample by sample, copied into one new array."""
        n, r = self.tree.n, self.recording
        assert r.velocity is not None
        assert r.acceleration is not None
        floating = (pin.JointModelFreeFlyer(),) if model == "wrench" else ()
        robot = pin.buildModelFromXML(self.urdf, *floating)
        data, regressor = robot.createData(), pin.computeJointTorqueRegressor
        if model == "torque":
            q, qd, qdd = r.position, r.velocity, r.acceleration
            shape = (samples, n, 10 * n)
        else:
            q = np.zeros((samples, n + 7))
            q[:, 6], q[:, 7:] = 1.0, r.position[:samples]
            qd, qdd = np.zeros((2, samples, n + 6))
            qd[:, 6:], qdd[:, 6:] = r.velocity[:samples], r.acceleration[:samples]
            shape = (samples, 6, 10 * (n + 1))

        def run() -> None:
            out, rows = np.empty(shape), shape[1]
            for k in range(samples):
                out[k] = regressor(robot, data, q[k], qd[k], qdd[k])[:rows]

        return run


def cases() -> list[Case]:
    """Three robots with random states, torques and wrenches."""
    found = []
    for name, urdf in robots().items():
        tree, rng = load(urdf), np.random.default_rng(0)
        q, qd, qdd, torque = rng.uniform(-2, 2, (4, SAMPLES, tree.n))
        wrench = rng.uniform(-2, 2, (SAMPLES, 6))
        recording = Recording(
            tree.names, np.arange(SAMPLES) / 1000, q, torque, wrench, qd, qdd, tare=np.zeros(6)
        )
        found.append(Case(name, tree, urdf, recording))
    return found


def operations(found: Layout) -> tuple[float, float]:
    """Vector operations of a sample's rows, and of their products."""
    robot, rows = found.robot, found.rows
    own = rows.source == rows.target
    links = np.repeat(np.arange(len(robot.place)), np.diff(rows.first))
    inclined = ~robot.square[links] & ~rows.force & ~own
    count = LINK * len(robot.place) + SINE * np.sum(~robot.prismatic)
    count += HERE * own.sum() + PUSH * np.sum(rows.force & ~own)
    count += CARRY * np.sum(~rows.force & ~own) + INCLINED * inclined.sum()
    return float(count), float(np.sum(rows.group_size * (rows.group_size + 1)) / 2)


def stack(case: Case, minimal: tb.MinimalSet) -> tuple[Array, Array]:
    """A dense problem for lstsq, as users set it up, ready in memory."""
    rng, samples = np.random.default_rng(1), STACK[case.name]
    rows = samples * (case.tree.n if minimal.model == "torque" else 6)
    return rng.normal(size=(rows, minimal.count)), rng.normal(size=rows)


def compare(case: Case, model: Signal, rounds: int) -> dict[str, Any]:
    """Kernel, fused pass and both passes against loop and lstsq, one core each."""
    minimal = tb.minimal_set(case.tree, model)
    found = make_layout(case.tree, minimal)
    signals = case.signals(found)
    work = numba_engine.workspace(found, signals)
    a, b = stack(case, minimal)
    tasks = {
        "loop": case.loop(model),
        "kernel": lambda: numba_engine.fill_rows(found, signals, work),
        "fused": lambda: numba_engine.row_products(found, signals, work),
    }
    best = least(tasks, rounds)
    best |= least({"lstsq": lambda: np.linalg.lstsq(a, b, rcond=None)}, max(3, rounds // 8))
    samples = dict.fromkeys(best, SAMPLES) | {"loop": LOOP, "lstsq": STACK[case.name]}
    ns = {name: 1e9 * best[name] / samples[name] for name in best}
    today, peak = ns["loop"] + ns["lstsq"], peak_flops()
    recursion, products = operations(found)
    return {
        "benchmark": model,
        "robot": case.name,
        "joints": case.tree.n,
        "parameters": minimal.count,
        "ns_per_sample": {name: round(value, 1) for name, value in ns.items()},
        "kernel_ratio": round(ns["loop"] / ns["kernel"], 1),
        "fused_ratio": round(today / ns["fused"], 1),
        "limit_ns": round(2e9 * (recursion + products) / peak, 1),
        "over_limit": round(ns["fused"] * peak / (2e9 * (recursion + products)), 2),
        "peak_gflops": round(peak / 1e9, 1),
        "peak_rss_mb": round(peak_rss()),
    }


def main(rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 60) -> None:
    """Rows, and sums of their products, against Pinocchio in a loop and lstsq."""
    for case, model in product(cases(), MODELS):
        print_lines([compare(case, model, rounds if case.tree.n < 10 else rounds // 4)])
