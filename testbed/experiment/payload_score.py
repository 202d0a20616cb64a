"""A payload in the plant, found as `testbed payload` finds it: against the robot without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.experiment.evaluate import robot_of
from testbed.experiment.experiment import Experiment
from testbed.experiment.run import Run
from testbed.experiment.simulate import simulate
from testbed.identification.identify import identify
from testbed.identification.payload.payload import payload
from testbed.identification.regression.passes import Progress
from testbed.simulation.bodies import Payload


def with_payload_metrics(run: Run, progress: Progress = lambda done, total: None) -> Run:
    """A run with the figures of its payload, if a claim is about them.

    The robot without the payload makes another recording, with other noise.

    Args:
        run: The run.
        progress: Called with samples done and samples in all.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "external" not in run.estimates:
        return run
    loads = [each for each in experiment.simulation.effect if isinstance(each, Payload)]
    if len(loads) != 1 or not any(name.startswith("payload_") for name in experiment.expect):
        return run
    empty = _without(experiment)
    tree, settings = robot_of(empty), replace(experiment.identification, zeros=False)
    without = identify(tree, simulate(empty, progress).blind(), settings=settings)
    loaded = identify(tree, run.recording.blind(), settings=settings)
    found = payload(tree, without, loaded, loads[0].joint or None)
    metrics = dict(run.score.metrics)
    if found.identifiable[0]:
        error, sigma = float(found.values[0]) - loads[0].mass, float(found.sigma[0])
        metrics |= {
            "payload_mass_error": abs(error),
            "payload_mass_sigma": sigma,
            "payload_mass_z": abs(error) / sigma,
        }
    if found.centre is not None:
        off = found.centre[0] - np.broadcast_to(np.asarray(loads[0].centre), 3)
        if np.isfinite(off).all():
            metrics["payload_centre_error"] = float(np.linalg.norm(off))
    judged = replace(run, score=replace(run.score, metrics=metrics))
    return judged.with_diagnostics(found.diagnostics)


def _without(experiment: Experiment) -> Experiment:
    """The same without payloads, with another motion and other noise."""
    effects = tuple(e for e in experiment.simulation.effect if not isinstance(e, Payload))
    simulation = experiment.simulation.model_copy(update={"effect": effects})
    return experiment.model_copy(update={"simulation": simulation, "seed": experiment.seed + 2})
