"""What an experiment records: excite, simulate, measure."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from testbed.excitation.fourier import Fourier
from testbed.experiment.experiment import Experiment
from testbed.experiment.prepare import Plants, Prepared, prepare
from testbed.experiment.versions import versions
from testbed.files import fingerprint
from testbed.identification.passes import Progress
from testbed.instruments.chain import measure
from testbed.recordings.geometry import geometry
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree
from testbed.simulation.effect import StepForces
from testbed.simulation.rollout import Rollout, SimulationDiverged, Watch, simulate_motions

MOST_SAMPLES_TOGETHER = 6e5
"""Most samples of runs that go side by side."""


def simulate(
    experiment: Experiment,
    progress: Progress = lambda done, total: None,
    watch: Watch = lambda time, truth: None,
    forces: StepForces | None = None,
    installed: int | None = None,
    motion: Fourier | None = None,
) -> Recording:
    """Simulate an experiment's robot on its bedplate and measure it.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        forces: On the joints, besides motors and the model's friction, asked before every step.
        installed: Seed of what chance decides once of the instrument; default the experiment's.
        motion: In place of the experiment's.
    """
    ready = prepare(experiment, forces, motion=motion)
    asked = ready.end, ready.sampling, progress, watch, ready.forces
    (happened,) = simulate_motions([ready.task], *asked)
    if isinstance(happened, SimulationDiverged):
        raise happened
    return _measured(ready, happened, installed)


def _measured(ready: Prepared, happened: Rollout, installed: int | None = None) -> Recording:
    """What the instrument shows of it."""
    experiment, tree, seed = ready.experiment, ready.tree, ready.experiment.seed
    facts, tare = _facts(experiment, tree, happened) | dict(ready.facts), ready.task.plant.tare
    instrument, names = experiment.measurement, tree.names
    return measure(instrument, names, happened.time, happened.truth, tare, facts, seed, installed)


def simulate_together(experiments: Sequence[Experiment]) -> Iterator[Recording | Exception]:
    """Simulate experiments: those of one model side by side, what happens twice only once.

    Every recording is, to the bit, the one that `simulate` makes of its experiment.

    Args:
        experiments: What to do.

    Yields:
        Of each experiment its recording, or why there is none.
    """
    ready: list[Prepared | Exception] = []
    plants: Plants = {}
    for experiment in experiments:
        try:
            ready.append(prepare(experiment, None, plants))
        except Exception as error:
            ready.append(error)
    happened = _happened(each for each in ready if isinstance(each, Prepared))
    for each in ready:
        if isinstance(each, Exception):
            yield each
            continue
        result = happened[each.happens]
        try:
            yield result if isinstance(result, Exception) else _measured(each, result)
        except Exception as error:
            yield error


def _happened(ready: Iterable[Prepared]) -> dict[Hashable, Rollout | Exception]:
    """What happens in each run, by what determines it."""
    different = {each.happens: each for each in ready}
    alone = [key for key, each in different.items() if each.forces is not None]
    groups: dict[Hashable, list[Hashable]] = {key: [key] for key in alone}
    for key, each in different.items():
        if key not in groups:
            groups.setdefault(each.shares, []).append(key)
    found: dict[Hashable, Rollout | Exception] = {}
    for keys in groups.values():
        for part in _parts(keys, different):
            first = part[0]
            asked = first.end, first.sampling
            rollouts: Sequence[Rollout | Exception]
            try:
                rollouts = simulate_motions([e.task for e in part], *asked, forces=first.forces)
            except Exception as error:
                rollouts = [error] * len(part)
            found |= {each.happens: result for each, result in zip(part, rollouts, strict=True)}
    return found


def _parts(
    keys: Sequence[Hashable], ready: Mapping[Hashable, Prepared]
) -> Iterator[list[Prepared]]:
    """As many side by side as memory is meant to hold."""
    first = ready[keys[0]]
    samples = first.end * first.sampling.rate
    count = int(max(1, MOST_SAMPLES_TOGETHER // samples))
    for start in range(0, len(keys), count):
        yield [ready[key] for key in keys[start : start + count]]


def _facts(experiment: Experiment, tree: Tree, run: Rollout) -> dict[str, Any]:
    """What a recording keeps about how it was made."""
    saturated = [
        f"the motor of joint '{name}' was at its limit in {share:.1%} of the samples"
        for name, share in zip(tree.names, run.saturated, strict=True)
        if share
    ]
    return {
        "robot": tree.name,
        "geometry": geometry(tree),
        "gravity": tree.gravity.tolist(),
        "model_sha256": fingerprint(Path(experiment.model)),
        "seed": experiment.seed,
        "versions": versions(),
        "tracking_rms": dict(zip(tree.names, run.tracking.tolist(), strict=True)),
        "warnings": saturated,
    }
