"""From an experiment's recording to its run, and the error that a coarse step leaves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.prior import Prior, prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.base.stages import Progress, unreported
from testbed.core.estimation.estimate import METHODS, Method
from testbed.core.estimation.identify import identify
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.symbols import standard
from testbed.core.recordings.recording import Recording
from testbed.core.robot.inertia import Inertia, upper_root
from testbed.core.robot.rotor_spin import with_rotor_spin
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import SimulationTable
from testbed.lab.experiment.rig import sensed_robot
from testbed.lab.experiment.run import Run, assemble_run
from testbed.lab.experiment.score import (
    relative_errors,
    root_mean_square,
    shared_errors,
)
from testbed.lab.instruments.chain import Instrument, measured_again
from testbed.lab.instruments.error_chain import stream

FINE = SimulationTable().step
"""Step up to which the floor is not looked for [s]: it is below what instruments leave."""


def with_floor(run: Run) -> Run:
    """A run with the metric `external_floor`, where its step is coarse.

    Args:
        run: Of an experiment.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "external" not in run.estimates:
        return run
    if experiment.simulation.step <= FINE * (1 + 1e-9):
        return run
    asked = experiment.measurement
    perfect = Instrument(rate=asked.rate, averaged=asked.averaged)
    seen = replace(
        measured_again(run.recording, perfect, experiment.seed).blind(), tare=None
    )
    plain = replace(run.settings, nuisances=(), known={})
    try:
        estimate = identify(run.tree, seen, "external", settings=plain, threads=1)
    except TestbedError:
        return run
    floor = root_mean_square(shared_errors(run.tree, estimate.base.values, plain.zeros))
    if floor is None:
        return run
    return run.with_metrics({"external_floor": floor})


def evaluate(
    experiment: Experiment,
    recording: Recording,
    progress: Progress = unreported,
    methods: Iterable[Method] = METHODS,
    threads: int | None = None,
) -> Run:
    """Identify from an experiment's recording and compare with the truth.

    With consistent bodies, where the experiment asks for them.

    Args:
        experiment: What was carried out.
        recording: What the instrument measured.
        progress: Called with samples done and samples in all, method by method.
        methods: Which estimates to make.
        threads: How many to use; default one a processor.
    """
    tree = with_rotor_spin(sensed_robot(experiment), experiment.robot.spins)
    run = assemble_run(
        tree,
        recording,
        name=experiment.name,
        settings=experiment.identification,
        experiment=experiment,
        methods=methods,
        bodies=bodies_asked(experiment, tree),
        threads=threads,
        progress=progress,
    )
    return with_floor(with_body_metrics(run))


def bodies_asked(
    experiment: Experiment, tree: Tree
) -> tuple[Prior, ConsistencyOptions] | None:
    """Prior and conditions of consistent bodies, where an experiment asks for them.

    The model file is the truth in an experiment, so the prior is a wrong one.

    Args:
        experiment: What was carried out.
        tree: The robot with its true bodies.
    """
    options = experiment.consistent
    if options is None:
        return None
    return prior_of(wrong_prior(tree, experiment)), options


def wrong_bodies(tree: Tree, error: float, rng: np.random.Generator) -> Tree:
    """The robot with other possible bodies.

    J = U U' becomes U G G' U', G a matrix that differs from one by random numbers: mass, centre
    and inertia change together, each by about the same part of itself. Bodies whose J has no
    such root (rods, plates, none) stay.

    Args:
        tree: The robot with its true bodies.
        error: Standard deviation of every coordinate of J, in parts of the body.
        rng: Draws the numbers.
    """
    return replace(
        tree, inertias=tuple(_wrong(body, error, rng) for body in tree.inertias)
    )


def _wrong(body: Inertia, error: float, rng: np.random.Generator) -> Inertia:
    change = np.eye(4) + error / 2 * rng.normal(size=(4, 4))
    try:
        root = upper_root(body.pseudo) @ change
    except np.linalg.LinAlgError:
        return body
    return Inertia.of_pseudo(root @ root.T)


def with_body_metrics(run: Run) -> Run:
    """A run with figures of its consistent bodies, if it has them and the truth is known.

    Args:
        run: The run.
    """
    if run.score is None or run.consistent is None:
        return run
    return run.with_metrics(_metrics(run, run.consistent))


def wrong_prior(tree: Tree, experiment: Experiment) -> Tree:
    """The robot with the bodies that the experiment starts from.

    Args:
        tree: The robot with its true bodies.
        experiment: Says how wrong they are.
    """
    return wrong_bodies(tree, experiment.prior.error, stream("prior", experiment.seed))


def _metrics(run: Run, found: Consistent) -> dict[str, float]:
    """Figures of consistent bodies against the truth."""
    massive = found.eigenvalues[found.eigenvalues[:, -1] > 0]
    consistent, prior = _error(run, found.standard), _error(run, found.prior)
    least = (massive[:, 0] / massive[:, -1]).min(initial=np.inf)
    plain = (
        run.metrics.get(f"{method}_rms_relative_error") for method in run.estimates
    )
    first = next((error for error in plain if error is not None), None)
    ratio = (
        None if consistent is None or first is None else consistent / max(first, TINY)
    )
    metrics = {
        "consistent_rms_relative_error": consistent,
        "prior_rms_relative_error": prior,
        "consistent_least_eigenvalue": float(least) if len(massive) else None,
        "consistent_to_plain": ratio,
    }
    return {name: value for name, value in metrics.items() if value is not None}


def _error(run: Run, bodies: Array) -> float | None:
    """Rms relative error of delta_d by bodies, (n, 10)."""
    dynamic = minimal_set(run.tree, "dynamic", zeros=run.settings.zeros)
    matrix = dynamic.standard_matrix
    truth = matrix @ standard(run.tree).ravel()
    return root_mean_square(
        relative_errors(matrix @ bodies.ravel(), truth, dynamic.units)
    )
