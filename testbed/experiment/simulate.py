"""What an experiment records: excite, simulate, measure."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any

from testbed.diagnostics.diagnostic import diagnose
from testbed.excitation.fourier import Fourier
from testbed.experiment.experiment import Experiment
from testbed.experiment.prepare import Plants, Prepared, prepare
from testbed.experiment.versions import versions
from testbed.files import fingerprint
from testbed.identification.regression.passes import Progress
from testbed.instruments.chain import measure
from testbed.recordings.geometry import geometry
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree
from testbed.simulation.effect import StepForces
from testbed.simulation.rollout import Rollout, Watch


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
    return _measured(ready, ready.rollout(progress, watch), installed)


def _measured(ready: Prepared, happened: Rollout, installed: int | None = None) -> Recording:
    """What the instrument shows of it."""
    experiment, tree, seed = ready.experiment, ready.tree, ready.experiment.seed
    facts, tare = _facts(experiment, tree, happened) | dict(ready.facts), ready.plant.tare
    instrument, names = experiment.measurement, tree.names
    return measure(instrument, names, happened.time, happened.truth, tare, facts, seed, installed)


def simulate_together(experiments: Sequence[Experiment]) -> Iterator[Recording | Exception]:
    """Simulate experiments; what happens twice only once.

    Every recording is, to the bit, the one that `simulate` makes of its experiment.

    Args:
        experiments: What to do.

    Yields:
        Of each experiment its recording, or why there is none.
    """
    plants: Plants = {}
    happened: dict[Hashable, Rollout | Exception] = {}
    for experiment in experiments:
        try:
            ready = prepare(experiment, None, plants)
            if ready.happens not in happened:
                happened[ready.happens] = _rollout(ready)
            result = happened[ready.happens]
            yield result if isinstance(result, Exception) else _measured(ready, result)
        except Exception as error:
            yield error


def _rollout(ready: Prepared) -> Rollout | Exception:
    try:
        return ready.rollout()
    except Exception as error:
        return error


def _facts(experiment: Experiment, tree: Tree, run: Rollout) -> dict[str, Any]:
    """What a recording keeps about how it was made."""
    saturated = [
        diagnose("motion.saturated", name, share).as_dict()
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
        "diagnostics": saturated,
    }
