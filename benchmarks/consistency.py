"""Do consistent bodies cost accuracy, save it where data are poor, and survive being written?"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import testbed as tb
from testbed.bodies.consistency.consistent import Consistent, consistent, robot_of
from testbed.bodies.consistency.options import ConsistencyOptions, Metric
from testbed.bodies.prior import prior_of
from testbed.bodies.write_model import write_model
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnseenParameters
from testbed.core.estimation.estimate import METHODS, Estimate
from testbed.core.robot.model_file import ModelFile
from testbed.lab.experiment.evaluate import wrong_bodies
from testbed.lab.experiment.score import relative_errors, root_mean_square
from tests.helpers.measured import measured
from tests.helpers.mujoco_inverse import by_mj_inverse
from tests.helpers.paths import ROOT
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import random_robot, random_states

PRIOR = 0.3
"""How wrong the model file's bodies are made."""


def accuracy(durations: tuple[float, ...], seeds: range) -> Iterator[dict[str, Any]]:
    """Errors of consistent bodies beside those of plain estimates, on the PUMA of table6."""
    for seconds in durations:
        ratios: dict[str, list[float]] = {}
        least: list[float] = []
        for seed in seeds:
            overrides = [f"motion.duration={seconds}", f"seed={seed}"]
            experiment = tb.Experiment.load(ROOT / "experiments/table6.toml", overrides)
            tree, recording = tb.load_tree(experiment.model), tb.record(experiment)
            estimates = [
                tb.identify(tree, recording, m, settings=experiment.identification) for m in METHODS
            ]
            prior = prior_of(wrong_bodies(tree, PRIOR, np.random.default_rng([seed, 17])))
            for used in (estimates[:1], estimates[1:], estimates):
                found = consistent(tree, used, prior)
                least += (found.eigenvalues[:, 0] / found.eigenvalues[:, -1]).tolist()
                for estimate, own in zip(used, found.bent, strict=True):
                    key = f"{estimate.method} of {len(used)}"
                    ratios.setdefault(key, []).append(_ratio(tree, estimate, own.values))
        yield {
            "what": "consistent over plain error, table6",
            "seconds": seconds,
            "seeds": len(seeds),
            "median": {k: round(float(np.median(v)), 3) for k, v in ratios.items()},
            "most": {k: round(max(v), 3) for k, v in ratios.items()},
            "least eigenvalue ratio": float(f"{min(least):.2g}"),
        }


def poor(seeds: range, speed: float) -> dict[str, Any]:
    """The same where a PUMA moves slowly, 5 s: at a part of a usual speed."""
    tree = tb.load_tree(ROOT / "models/puma562.xml")
    ratios: dict[str, list[float]] = {}
    plain: dict[str, list[float]] = {}
    for seed in seeds:
        recording = measured(tree, seed, duration=5.0, speed=speed)
        prior = prior_of(wrong_bodies(tree, PRIOR, np.random.default_rng([seed, 17])))
        for method in METHODS:
            try:
                estimate = tb.identify(tree, recording, method)
            except UnseenParameters:
                continue
            found = consistent(tree, [estimate], prior)
            ratios.setdefault(method, []).append(_ratio(tree, estimate, found.bent[0].values))
            plain.setdefault(method, []).append(_error(tree, estimate, estimate.values))
    return {
        "what": "consistent over plain error, PUMA, 5 s",
        "speed": speed,
        "seeds": {k: len(v) for k, v in ratios.items()},
        "median of plain": {k: round(float(np.median(v)), 3) for k, v in plain.items()},
        "median": {k: round(float(np.median(v)), 3) for k, v in ratios.items()},
        "most": {k: round(max(v), 3) for k, v in ratios.items()},
    }


def _ratio(tree: tb.Tree, estimate: Estimate, values: Array) -> float:
    """Error of consistent parameters over that of the plain ones."""
    return _error(tree, estimate, values) / _error(tree, estimate, estimate.values)


def _error(tree: tb.Tree, estimate: Estimate, values: Array) -> float:
    """Rms relative error of minimal parameters."""
    minimal = estimate.minimal
    truth = minimal.values(tb.barycentric(tree))
    error = root_mean_square(relative_errors(values[: len(truth)], truth, minimal.units))
    assert error is not None
    return float(error)


def trees(count: int, first: int = 0) -> dict[str, Any]:
    """Random trees of 3 to 12 joints: solved, written to URDF and MJCF, read back."""
    solved, gaps = 0, {"urdf": 0.0, "xml": 0.0, "mujoco": 0.0}
    least, errors = np.inf, []
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        robot = random_robot(rng, int(rng.integers(3, 13)))
        tree = robot.tree()
        recording = measured(tree, seed, duration=10.0)
        wrong = wrong_bodies(tree, PRIOR, rng)
        try:
            estimates = [tb.identify(tree, recording, method) for method in METHODS]
        except tb.TestbedError as error:
            errors.append(f"{seed}: {error}"[:80])
            continue
        found = consistent(tree, estimates, prior_of(wrong))
        solved += bool(found.unsettled < 1e-3 and (found.eigenvalues[:, 0] > 0).all())
        least = min(least, float((found.eigenvalues[:, 0] / found.eigenvalues[:, -1]).min()))
        for ending, text in (("urdf", robot.urdf()), ("xml", robot.mjcf())):
            gap, other = _round_trip(tree, found, text, ending)
            gaps[ending] = max(gaps[ending], gap)
            gaps["mujoco"] = max(gaps["mujoco"], other)
    return {
        "what": "random trees",
        "count": count,
        "solved": solved,
        "not identified at all": errors,
        "least eigenvalue ratio": float(f"{least:.2g}"),
        "round trip": {k: float(f"{v:.1e}") for k, v in gaps.items()},
    }


def _round_trip(tree: tb.Tree, found: Consistent, text: str, ending: str) -> tuple[float, float]:
    """Largest gap in parts of a body by our reader; and of MuJoCo's masses."""
    with tempfile.TemporaryDirectory() as folder:
        source, path = Path(folder, f"robot.{ending}"), Path(folder, f"written.{ending}")
        source.write_text(text)
        model = ModelFile(source)
        wanted = robot_of(found, model.tree())
        write_model(model, wanted, path)
        read = tb.load_tree(path)
        compiled = mujoco.MjModel.from_xml_path(str(path))
    gaps = [
        max(
            abs(a.mass - b.mass) / b.mass,
            np.abs(a.first_moment - b.first_moment).max() / np.abs(b.first_moment).max(),
            np.abs(a.tensor - b.tensor).max() / np.abs(b.tensor).max(),
        )
        for a, b in zip(read.inertias, wanted.inertias, strict=True)
    ]
    names = {compiled.body(k).name: compiled.body_mass[k] for k in range(compiled.nbody)}
    masses = [
        abs(names[joint.body] - body.mass) / body.mass
        for joint, body in zip(wanted.joints, wanted.inertias, strict=True)
        if joint.body in names
    ]
    return max(gaps), max(masses, default=0.0)


def times(sizes: tuple[int, ...], metric: Metric) -> Iterator[dict[str, Any]]:
    """Seconds for the program alone, on one core."""
    for n in sizes:
        tree = random_robot(np.random.default_rng(n), n).tree()
        recording = measured(tree, n, duration=20.0)
        prior = prior_of(wrong_bodies(tree, PRIOR, np.random.default_rng(n)))
        estimates = [tb.identify(tree, recording, method) for method in METHODS]
        for used in (estimates[:1], estimates):
            spent = []
            for _ in range(3):
                start = time.perf_counter()
                consistent(tree, used, prior, ConsistencyOptions(metric=metric))
                spent.append(time.perf_counter() - start)
            yield {
                "what": f"seconds, {metric}",
                "joints": n,
                "estimates": len(used),
                "seconds": round(min(spent), 3),
            }


def prediction(seed: int) -> dict[str, Any]:
    """Torques along an unseen motion by the written files, in plain Pinocchio and MuJoCo."""
    gaps = {}
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 7)
    tree = robot.tree()
    recording = measured(tree, seed, duration=10.0)
    estimates = [tb.identify(tree, recording, method) for method in METHODS]
    found = consistent(tree, estimates, prior_of(wrong_bodies(tree, PRIOR, rng)))
    states = random_states(rng, 50, tree.n)
    with tempfile.TemporaryDirectory() as folder:
        for ending, text in (("urdf", robot.urdf()), ("xml", robot.mjcf())):
            source, path = Path(folder, f"robot.{ending}"), Path(folder, f"written.{ending}")
            source.write_text(text)
            model = ModelFile(source)
            wanted = robot_of(found, model.tree())
            write_model(model, wanted, path)
            motion = tb.Motion(np.arange(50.0), *states)
            ours = tb.joint_forces(wanted, motion)
            if ending == "urdf":
                theirs = by_pinocchio(path.read_text(), wanted, states).forces
            else:
                theirs = by_mj_inverse(path, wanted, states)
                ours = ours + _losses(wanted, states[1])
            gaps[ending] = float(f"{np.abs(theirs - ours).max() / np.abs(ours).max():.1e}")
    return {
        "what": "torques of an unseen motion",
        "pinocchio": gaps["urdf"],
        "mj_inverse": gaps["xml"],
    }


def _losses(tree: tb.Tree, speed: Array) -> Array:
    """Of the joints, as mj_inverse counts them: damping; rotors are in the masses."""
    return np.asarray(speed * np.array([joint.viscous for joint in tree.joints]))
