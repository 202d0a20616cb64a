"""Fourteen runs from end to end, each made once in a process and shared by all tests.

`figures` gives what must not move while the house is rebuilt, as arrays of full precision.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

import testbed as tb
from benchmarks.foreign_recordings import LAYOUTS, planted, raw_signals
from testbed.applications.calibration import Calibration, calibrate
from testbed.applications.payload.payload import PayloadEstimate, payload
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import conduct
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.rules import SIGNALS
from testbed.core.recordings.views import with_base_joints
from testbed.core.robot.free_root import with_free_base
from testbed.importing.check.mapping_solution import solve_mapping
from testbed.importing.convert import import_recordings
from testbed.importing.guess import guess_mapping
from testbed.lab.experiment.excite import excite
from testbed.lab.experiment.experiment_tables import Bound
from testbed.motion.excite import Excitation
from tests.helpers.campaigns import NOISES, campaign_file
from tests.helpers.humanoid import humanoid
from tests.helpers.measured import clean, measured
from tests.helpers.paths import REAL, ROOT
from tests.helpers.plates import loaded, mass_of
from tests.helpers.robots import random_robot
from tests.helpers.runs import MODELS, experiment, robot, run_of


def figures_of_estimate(name: str, found: Estimate) -> Iterator[tuple[str, ArrayLike]]:
    """Numbers of an estimate."""
    yield f"{name} values", found.values
    yield f"{name} sigma", found.sigma
    yield f"{name} covariance norm", np.linalg.norm(found.covariance)
    yield f"{name} residual", found.residual
    yield f"{name} samples", found.samples
    yield f"{name} calibration", [[each.value, each.sigma] for each in found.nuisances]
    if found.noise is not None:
        yield f"{name} noise", [found.noise.factor, *np.atleast_1d(found.noise.memory)]


def figures_of_run(run: tb.Run) -> Iterator[tuple[str, ArrayLike]]:
    """Numbers of a run: its signals, estimates, metrics and whatever else it has."""
    for signal in ("position", "torque", "wrench"):
        if signal in run.recording.signals:
            yield f"{signal} rms", np.sqrt((run.recording.measured(signal) ** 2).mean(axis=0))
    for method, found in run.estimates.items():
        yield from figures_of_estimate(method, found)
    for name, value in sorted(run.metrics.items()):
        if "floor" not in name:  # of rounding alone
            yield f"metric {name}", value
    for method, validation in run.validation.items():
        yield f"{method} validation", validation.residual
    if run.drives is not None:
        yield "drives", [[each.constant, each.sigma] for each in run.drives.estimates]
    if run.consistent is not None:
        yield "bodies", run.consistent.standard


NO_FIGURE = re.compile("second|floor")
"""What is another number each time: clocks, and rounding."""


def figures_of_table(rows: list[dict[str, Any]]) -> Iterator[tuple[str, ArrayLike]]:
    """Numbers of a campaign's runs."""
    for name in sorted(rows[0]):
        values = [row[name] for row in rows]
        if all(isinstance(value, float) for value in values) and not NO_FIGURE.search(name):
            yield name, values


SHORT = ["motion.duration=8", "simulation.step=5e-4", "motion.candidates=4"]
"""Settings of runs that MuJoCo simulates."""


def _puma() -> tb.Run:
    return tb.carry_out(tb.Experiment.from_toml(ROOT / "experiments/table6.toml", SHORT))


NOISES_OF_UR5 = {"encoder": 1e-5, "force": 0.3, "moment": 0.06, "torque": 0.3}
"""Sizes [rad, N, N m, N m]."""


def _ur5() -> tb.Run:
    noises = [f"measurement.{name}_noise={size}" for name, size in NOISES_OF_UR5.items()]
    return tb.carry_out(tb.Experiment.of_model(MODELS["ur5"], [*SHORT, *noises]))


def _panda() -> tb.Run:
    tree = tb.load_tree(
        REAL / "panda_description/urdf/panda.urdf", lock={"panda_finger_joint1": None}
    )
    return run(tree, measured(tree, 4, duration=10.0))


def _gantry() -> tb.Run:
    return run(robot("gantry"), measured(robot("gantry"), 5, duration=10.0, memory=0.9))


def _tree_of_30() -> tb.Run:
    tree = random_robot(np.random.default_rng(30), 30).tree()
    return run(tree, measured(tree, 6, duration=10.0, rate=100.0))


def _free_base() -> tb.Run:
    tree, recording = humanoid(10.0, 100.0, 7, 1.0)
    return run(with_free_base(tree), with_base_joints(recording))


def _drives() -> tb.Run:
    terms = ("coulomb", "viscous", "offset", "rotor")
    recording = clean(robot("puma"), 3, duration=12.0)
    return run(robot("puma"), recording, Settings(drives="chosen", terms=terms))


def _payload() -> PayloadEstimate:
    one, other = (
        tb.identify(each, measured(each, seed, duration=10.0))
        for seed, each in ((8, robot("ur5")), (9, loaded(robot("ur5"))))
    )
    return payload(robot("ur5"), one, other)


def _plate() -> Calibration:
    tree, rng = robot("puma"), np.random.default_rng(10)
    mixing = np.eye(6) + 0.01 * rng.uniform(-1, 1, (6, 6))
    right = measured(tree, 10, duration=10.0)
    known = {"mass": mass_of(tree), "gain/Fz": float(mixing[2, 2])}
    return calibrate(tree, replace(right, wrench=right.measured("wrench") @ mixing.T), known)


def _imported() -> tb.Run:
    made, identifiable = planted("ur5", "any", "two_csv", 11)
    with TemporaryDirectory() as name:
        folder = Path(name)
        files = LAYOUTS["two_csv"](folder, made, raw_signals(made, identifiable), 11)
        draft = guess_mapping(files.paths, folder, made.tree.names)
        mapping = folder / "mapping.toml"
        mapping.write_text(solve_mapping(draft, mapping, made.tree).draft.text)
        (recording,), _ = import_recordings(mapping)
    return run(made.tree, recording)


def _several() -> tb.Run:
    tree = robot("puma")
    parts = [measured(tree, seed, duration=5.0) for seed in (12, 13)]
    found = {method: tb.identify(tree, tb.Joined(parts), method) for method in SIGNALS}
    return replace(run(tree, parts[0]), estimates=found)


def _campaign() -> list[dict[str, Any]]:
    with TemporaryDirectory() as folder:
        campaign = Campaign.load(campaign_file(Path(folder), 2, NOISES))
        conduct(campaign, Path(folder) / "r")
        rows: list[dict[str, Any]] = pq.read_table(Path(folder) / "r/results.parquet").to_pylist()
    return rows


def _motion() -> Excitation:
    quick = ["excitation.starts=1", "excitation.harmonics=4", "motion.duration=10"]
    return excite(tb.Experiment.of_model(MODELS["puma"], quick))


def _bodies() -> tb.Run:
    asked = experiment(expect={"consistent_to_plain": Bound(at_most=1.5)})
    asked = asked.model_copy(update={"consistent": ConsistencyOptions()})
    return run_of(robot("puma"), asked=asked)


def run(tree: tb.Tree, recording: tb.Recording, settings: Settings = DEFAULTS) -> tb.Run:
    """What both methods say."""
    return tb.assemble_run(tree, recording, name="scenario", settings=settings)


SCENARIOS: dict[str, Callable[[], Any]] = {
    "puma": _puma,
    "ur5": _ur5,
    "panda": _panda,
    "gantry": _gantry,
    "tree_of_30": _tree_of_30,
    "free_base": _free_base,
    "drives": _drives,
    "payload": _payload,
    "plate": _plate,
    "import": _imported,
    "several": _several,
    "campaign": _campaign,
    "motion": _motion,
    "bodies": _bodies,
}
"""How each result is made."""


@cache
def result(name: str) -> Any:
    """What a scenario gives; made once."""
    return SCENARIOS[name]()


def figures_of(found: Any) -> Iterator[tuple[str, ArrayLike]]:
    """What must not move of a result."""
    if isinstance(found, tb.Run):
        yield from figures_of_run(found)
    elif isinstance(found, PayloadEstimate):
        yield "values", found.values[list(found.identifiable)]
        yield "sigma", found.sigma[list(found.identifiable)]
        yield "chance", found.p_value
    elif isinstance(found, Calibration):
        yield "matrix", found.matrix
        if found.estimate is not None:
            yield from figures_of_estimate("wrench", found.estimate)
    elif isinstance(found, Excitation):
        yield "coefficients", found.design.motion.coefficients
        yield "sigma", found.predicted.sigma
        yield "gain", np.array(found.gain, dtype=float)
    else:
        yield from figures_of_table(found)


def figures(name: str) -> dict[str, Array]:
    """What must not move of a scenario."""
    return {key: np.asarray(value, dtype=float) for key, value in figures_of(result(name))}
