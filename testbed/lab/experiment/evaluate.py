"""Evaluate an experiment's recording: estimates, errors against the truth, integration error."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.prior import PriorBodies, prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.estimation.identify import identify
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.parameters.symbols import standard
from testbed.core.recordings.recording import Recording
from testbed.core.robot.inertia import Inertia, upper_cholesky_factor
from testbed.core.robot.rotor_spin import with_rotor_spin
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import SimulationTable
from testbed.lab.experiment.rig import sensed_robot
from testbed.lab.experiment.run import Run, assemble_run
from testbed.lab.experiment.score import finite_rms, relative_errors, torque_set_errors
from testbed.lab.instruments.chain import Instrument, remeasured
from testbed.lab.instruments.error_chain import random_stream

FINE_STEP = SimulationTable().step
"""Step up to which the integration error is not computed [s]: it is below the sensor errors."""


def with_integration_error(run: Run) -> Run:
    """Add the metric `wrench_floor`, the error due to the integration step, to a run.

    The metric is the rms relative error of the plate's estimate from perfect sensors. The run is
    unchanged if its step is at most `FINE_STEP`, if it has no score or no estimate from the force
    plate, or if no estimate can be made from the exact recording.

    Args:
        run: Run of an experiment.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "wrench" not in run.estimates:
        return run
    if experiment.simulation.step <= FINE_STEP * (1 + 1e-9):
        return run
    instrument = experiment.measurement
    perfect_instrument = Instrument(rate=instrument.rate, averaged=instrument.averaged)
    exact_recording = replace(
        remeasured(run.recording, perfect_instrument, experiment.seed).blind(),
        tare=None,
    )
    settings = replace(run.settings, nuisances=(), known={})
    try:
        estimate = identify(
            run.tree, exact_recording, "wrench", settings=settings, threads=1
        )
    except TestbedError:
        return run
    floor = finite_rms(
        torque_set_errors(run.tree, estimate.base.values, settings.zeros)
    )
    if floor is None:
        return run
    return run.with_metrics({"wrench_floor": floor})


def evaluate(
    experiment: Experiment,
    recording: Recording,
    progress: Progress = ignore_progress,
    methods: Iterable[Signal] = SIGNALS,
    threads: int | None = None,
) -> Run:
    """Identify parameters from an experiment's recording, and compare estimates with true values.

    Physically consistent bodies are estimated too if the experiment has the table [consistent]. If
    a method fails, the reason is recorded in `Run.failures`.

    Args:
        experiment: Experiment that made the recording.
        recording: Measured signals.
        progress: Called with the number of finished samples and of all samples, for each method in
            turn.
        methods: Methods of identification: "wrench", "torque" or both.
        threads: Number of threads; default one per processor.
    """
    tree = with_rotor_spin(sensed_robot(experiment), experiment.robot.rotor_spins)
    run = assemble_run(
        tree,
        recording,
        name=experiment.name,
        settings=experiment.identification,
        experiment=experiment,
        methods=methods,
        bodies=prior_and_options(experiment, tree),
        threads=threads,
        progress=progress,
    )
    return with_integration_error(with_body_metrics(run))


def prior_and_options(
    experiment: Experiment, tree: Tree
) -> tuple[PriorBodies, ConsistencyOptions] | None:
    """Prior and options of the consistent bodies in an experiment.

    In an experiment the model file is the truth, so the bodies of the prior are perturbed. The
    result is None if the experiment has no table [consistent].

    Args:
        experiment: Experiment with the size of the perturbation.
        tree: The robot with its true bodies.
    """
    options = experiment.consistent
    if options is None:
        return None
    return prior_of(perturbed_prior(tree, experiment)), options


def perturbed_robot(tree: Tree, error: float, rng: np.random.Generator) -> Tree:
    """Robot with randomly perturbed bodies that are physically consistent.

    The pseudo-inertia J = U U' becomes U G G' U', where G is the identity plus random numbers.
    Mass, centre of mass and inertia thus change together, each by about the same relative error.
    Bodies whose J has no such factorisation (rods, plates, massless bodies) are unchanged.

    Args:
        tree: The robot with its true bodies.
        error: Relative standard deviation of the perturbation of J; G differs from the identity by
            half of it.
        rng: Random generator.
    """
    return replace(
        tree,
        inertias=tuple(_perturbed_body(body, error, rng) for body in tree.inertias),
    )


def _perturbed_body(body: Inertia, error: float, rng: np.random.Generator) -> Inertia:
    """Body with a randomly perturbed pseudo-inertia (`perturbed_robot`).

    A body with a singular pseudo-inertia is returned unchanged.
    """
    factor = np.eye(4) + error / 2 * rng.normal(size=(4, 4))
    try:
        root = upper_cholesky_factor(body.pseudo) @ factor
    except np.linalg.LinAlgError:
        return body
    return Inertia.of_pseudo(root @ root.T)


def with_body_metrics(run: Run) -> Run:
    """Add the errors of the consistent bodies to a run's metrics.

    The run is unchanged if it has no consistent bodies or no known truth.

    Args:
        run: Run of an experiment.
    """
    if run.score is None or run.consistent is None:
        return run
    return run.with_metrics(_body_metrics(run, run.consistent))


def perturbed_prior(tree: Tree, experiment: Experiment) -> Tree:
    """Robot with the perturbed bodies that serve as an experiment's prior.

    Args:
        tree: The robot with its true bodies.
        experiment: Experiment with the relative error of the prior and the seed.
    """
    return perturbed_robot(
        tree, experiment.prior.error, random_stream("prior", experiment.seed)
    )


def _body_metrics(run: Run, bodies: Consistent) -> dict[str, float]:
    """Errors of consistent bodies and of their prior against the truth, by metric.

    The metrics are the rms relative errors of the bodies and of the prior, the ratio of the first
    to the least-squares error (of the plate's estimate if there is one), and the ratio of smallest
    to largest eigenvalue of the pseudo-inertias.
    """
    massive = bodies.eigenvalues[bodies.eigenvalues[:, -1] > 0]
    consistent, prior = (
        _rms_relative_error(run, bodies.standard),
        _rms_relative_error(run, bodies.prior),
    )
    smallest = (massive[:, 0] / massive[:, -1]).min(initial=np.inf)
    plain_errors = (
        run.metrics.get(f"{method}_rms_relative_error") for method in run.estimates
    )
    plain_error = next((error for error in plain_errors if error is not None), None)
    ratio = (
        None
        if consistent is None or plain_error is None
        else consistent / max(plain_error, SMALLEST_POSITIVE)
    )
    metrics = {
        "consistent_rms_relative_error": consistent,
        "prior_rms_relative_error": prior,
        "consistent_least_eigenvalue": float(smallest) if len(massive) else None,
        "consistent_to_plain": ratio,
    }
    return {name: value for name, value in metrics.items() if value is not None}


def _rms_relative_error(run: Run, bodies: Array) -> float | None:
    """Rms relative error of the joint torques' base parameters.

    The base parameters are computed from the standard parameters `bodies`, (n, 10).
    """
    torque_set = minimal_set(run.tree, "torque", zeros=run.settings.zeros)
    matrix = torque_set.standard_matrix
    truth = matrix @ standard(run.tree).ravel()
    return finite_rms(relative_errors(matrix @ bodies.ravel(), truth, torque_set.units))
