"""Carry out an experiment: simulate, identify, compare with the truth, validate."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from testbed.errors import RecordingError, TestbedError
from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment import Experiment
from testbed.experiment.payload_score import with_payload_metrics
from testbed.experiment.run import Run
from testbed.experiment.run_folder import write_recorded, write_result
from testbed.experiment.simulate import simulate
from testbed.experiment.unseen import on_unseen_motion
from testbed.identification.regression.passes import Progress
from testbed.simulation.rollout import Watch

Stage = Callable[[str], AbstractContextManager[Progress]]
"""Makes what shows how far a stage of this name is."""


def carry_out(
    experiment: Experiment,
    progress: Progress = lambda done, total: None,
    watch: Watch = lambda time, truth: None,
    *,
    folder: Path | None = None,
    stage: Stage | None = None,
) -> Run:
    """Simulate, identify by both methods, compare with the truth, validate on another motion.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        folder: Run folder to write: the recording as soon as it is measured, then the result.
        stage: Makes what is called in place of `progress`, stage by stage.

    Raises:
        TestbedError: It cannot be carried out; what is in the folder by then is kept.
    """
    begun = stage or (lambda name: nullcontext(progress))
    with begun("simulating") as bar:
        recording = simulate(experiment, bar, watch)
    if folder is not None:
        write_recorded(experiment, recording, folder)
    try:
        with begun("identifying") as bar:
            run = evaluate(experiment, recording, bar)
    except TestbedError as error:
        if folder is None:
            raise
        raise RecordingError(f"{error}; the recording is kept in '{folder}'") from None
    with begun("validating on an unseen motion") as bar:
        run = on_unseen_motion(with_payload_metrics(run, bar), bar)
    if folder is not None:
        write_result(run, folder)
    return run
