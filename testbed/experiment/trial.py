"""A second of a new experiment, and what the experiment needs where that second fails."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from testbed.errors import ExperimentError, InfeasibleMotion, TestbedError
from testbed.excitation.clearance import DistanceMeter
from testbed.excitation.rest_posture import tried_postures
from testbed.experiment.assumptions import STEPS
from testbed.experiment.evaluate import robot_of
from testbed.experiment.experiment import Experiment
from testbed.experiment.motions import rules_of
from testbed.experiment.simulate import simulate
from testbed.simulation.rollout import SimulationDiverged

SECOND = ("motion.duration=1", "motion.candidates=1", "simulation.warm_up=0.2")
"""What is tried of an experiment."""
SLOWER = 0.3
"""Pace at which a motion that goes astray is tried once more."""


@dataclass(frozen=True)
class Needs:
    """What an experiment needs to run.

    Attributes:
        step: Of the simulation [s].
        pace: Share of usual velocities and accelerations.
        exclude: Pairs of bodies that cannot be kept apart, by name.
        nothing_clear: Whether no motion keeps clear, whatever pairs are left out.
    """

    step: float
    pace: float = 1.0
    exclude: tuple[tuple[str, str], ...] = ()
    nothing_clear: bool = False


def tried_text(
    text: Callable[[Needs], str], needs: Needs, folder: Path, say: Callable[[str], None]
) -> str:
    """The text of an experiment of which a second has been simulated.

    Args:
        text: Of an experiment with these needs.
        needs: To begin with.
        folder: Where the file will be.
        say: Called with a line for each thing that is assumed because a trial failed.

    Raises:
        ExperimentError: Nothing that can be assumed makes it run; says what was tried.
    """
    done: list[str] = []
    while True:
        written = text(needs)
        experiment = Experiment.of_content(
            tomllib.loads(written), folder / "new.toml", settings=SECOND
        )
        try:
            simulate(experiment)
            break
        except TestbedError as error:
            more = _needs_after(error, experiment, needs)
            if more is None:
                tried = f" (tried: {'; '.join(done)})" if done else ""
                raise ExperimentError(f"no experiment is written: {error}{tried}") from None
            needs, cure = more
            done.append(cure)
    for line in done:
        say(f"ASSUMED, since a second of it did not run: {line}")
    return written


def _needs_after(
    error: TestbedError, experiment: Experiment, needs: Needs
) -> tuple[Needs, str] | None:
    """What may help after a failure, and that in words; None where nothing is known to."""
    if isinstance(error, SimulationDiverged):
        smaller = [step for step in STEPS if step < needs.step]
        if smaller:
            step = smaller[min(1, len(smaller) - 1)]
            return replace(needs, step=step), f"simulation.step = {step:g} s"
        if needs.pace == 1:
            return replace(needs, step=STEPS[2], pace=SLOWER), f"motion at {SLOWER:g} of its pace"
    if isinstance(error, InfeasibleMotion) and experiment.excitation.clearance != "off":
        pairs = () if needs.exclude else _touching(experiment)
        if pairs:
            shown = ", ".join(f"'{a}' to '{b}'" for a, b in pairs[:5])
            more = f" and {len(pairs) - 5} more" if len(pairs) > 5 else ""
            return replace(needs, exclude=pairs), f"clearance leaves out {shown}{more}"
        return replace(needs, exclude=(), nothing_clear=True), "no clearance"
    return None


def _touching(experiment: Experiment) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies that are too near in the posture where the fewest are."""
    tree = robot_of(experiment)
    rules = rules_of(experiment, tree, designed=False)
    if rules.collision is None:
        return ()
    meter = DistanceMeter(rules.collision, float(rules.clearance.max(initial=0)) * 2)
    near = meter.measure(tried_postures(rules.limits)).values
    near = near <= rules.clearance
    fewest = near[near.sum(axis=1).argmin()]
    return tuple(
        pair for pair, is_near in zip(rules.collision.bodies, fewest, strict=True) if is_near
    )
