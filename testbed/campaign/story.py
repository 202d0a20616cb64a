"""A run as a report tells it: what was asked, what came out, and a motion nobody has seen."""

from __future__ import annotations

from pathlib import Path

from testbed.campaign.archive import result
from testbed.campaign.carry_out import Outcome, simulate
from testbed.campaign.experiment import Experiment
from testbed.identification.stream import Progress
from testbed.measurement.recording import Recording
from testbed.report.contents import Subject
from testbed.report.tables import truths_by_name

UNSEEN = 12.0
"""Seconds of the motion on which predictions are checked."""


def subject_of(outcome: Outcome, progress: Progress = lambda done, total: None) -> Subject:
    """What there is to report of a run; simulates another motion to check predictions on.

    Args:
        outcome: What came of the experiment.
        progress: Called with samples done and samples in all.
    """
    experiment, compared = outcome.experiment, outcome.comparison
    truths = truths_by_name(outcome.internal, compared.internal.truth)
    truths |= truths_by_name(outcome.external, compared.external.truth)
    metrics = compared.metrics
    verdicts = []
    for name, bound in experiment.expect.items():
        wanted = ", ".join(
            f"{k.replace('_', ' ')} {v:g}" for k, v in bound.model_dump(exclude_none=True).items()
        )
        verdicts.append(
            {
                "name": name.replace("_", " "),
                "wanted": wanted,
                "value": f"{metrics[name]:.3g}",
                "holds": bound.holds(metrics[name]),
            }
        )
    return Subject(
        title=experiment.name,
        tree=outcome.tree,
        recording=outcome.recording,
        unseen=unseen(experiment, progress),
        external=outcome.external,
        internal=outcome.internal,
        truths=truths,
        claim=experiment.claim,
        verdicts=verdicts,
        asked=_asked(outcome),
        origin=_origin(outcome),
        doubts=outcome.doubts,
    )


def unseen(experiment: Experiment, progress: Progress) -> Recording:
    """The same robot and instrument along another motion, with other noise."""
    motion = experiment.motion.model_copy(update={"duration": UNSEEN, "candidates": 1})
    other = experiment.model_copy(update={"motion": motion, "seed": experiment.seed + 1})
    return simulate(other, progress)


def _asked(outcome: Outcome) -> list[tuple[str, str]]:
    experiment = outcome.experiment
    motion, plate = experiment.motion, experiment.measurement
    errors = ", ".join(f"{k} {v:+.0%}" for k, v in plate.torque_constant_error.items())
    return [
        ("robot", f"{outcome.tree.name}, {outcome.tree.n} joints: {', '.join(outcome.tree.names)}"),
        ("model file", Path(experiment.model).name),
        (
            "motion",
            f"{motion.duration:g} s, repeats at {motion.fundamental:g} Hz with {motion.harmonics} "
            f"harmonics, the best of {motion.candidates}",
        ),
        (
            "encoders",
            f"{plate.rate:g} samples a second, resolution {plate.encoder_resolution:g}, noise "
            f"{plate.encoder_noise:g} [rad or m]",
        ),
        (
            "bedplate",
            f"noise {plate.force_noise:g} N and {plate.moment_noise:g} N m a sample",
        ),
        (
            "drives",
            f"torque noise {plate.torque_noise:g} [N m or N]"
            + (f", torque constants off by {errors}" if errors else ""),
        ),
        ("joint friction", "as in the model file" if experiment.simulation.friction else "none"),
    ]


def _origin(outcome: Outcome) -> list[tuple[str, str]]:
    facts = result(outcome)
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    return [
        ("model's SHA-256", facts["model_sha256"]),
        ("seed", str(outcome.experiment.seed)),
        ("versions", versions),
        ("again", "testbed run experiment.toml, with the file of the run folder"),
    ]
