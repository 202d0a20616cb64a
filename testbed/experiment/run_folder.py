"""A run folder: everything needed to repeat a run and to read its result.

experiment.toml   the experiment, every default written out
motion.toml       the motion, if the experiment runs one of a file
model/            the model file and what it refers to: a run folder needs nothing else
recording.parquet what was measured (and, apart, what happened)
unseen.parquet    what was measured on another motion, on which the estimates are validated
estimates.json.gz all that came of it, for `read_run`
result.json       estimates, truth, metrics, verdicts, versions; written after the others
"""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from pathlib import Path

from testbed.codec import json_text
from testbed.errors import ExperimentError
from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment import Experiment
from testbed.experiment.results import read_estimates, result_of, write_estimates
from testbed.experiment.run import Run
from testbed.experiment.versions import versions
from testbed.files import fingerprint, replacing
from testbed.recordings.recording import Recording
from testbed.robot.model_file import copy_model, model_format

EXPERIMENT, RECORDING, RESULT = "experiment.toml", "recording.parquet", "result.json"
MOTION, UNSEEN, ESTIMATES = "motion.toml", "unseen.parquet", "estimates.json.gz"
MODEL = "model"
"""Folder of the model file and what it refers to."""


def default_folder(experiment: Experiment) -> Path:
    """runs/NAME-HASH, the hash over the experiment and the model file's content."""
    return Path("runs") / f"{experiment.name}-{_identity(experiment)[:8]}"


def check_folder(folder: Path, experiment: Experiment, *, force: bool = False) -> None:
    """Whether a run may be written there: a new place, the same run again, or any by force.

    Args:
        folder: Where to.
        experiment: Of the run.
        force: Whether a run of another experiment may be replaced.

    Raises:
        ExperimentError: Something else is there.
    """
    if not folder.is_dir():
        return
    present = {p.name for p in folder.iterdir()}
    own = {EXPERIMENT, RECORDING, RESULT, MODEL, MOTION, UNSEEN, ESTIMATES}
    others = sorted(present - own)
    if present and (others or EXPERIMENT not in present):
        listed = ", ".join((others or sorted(present))[:3])
        raise ExperimentError(
            f"'{folder}' is no run folder: it holds {listed}"
            f"{' ...' if len(others) > 3 else ''}; name another with --out"
        )
    if present and not force and not _is_of(folder, experiment):
        raise ExperimentError(
            f"'{folder}' holds a run of another experiment; --force replaces it, --out names "
            "another folder"
        )


def write_run(run: Run, folder: Path) -> None:
    """Write a run folder; an older one is replaced at once.

    Args:
        run: Of an experiment.
        folder: Where to.

    Raises:
        ExperimentError: No experiment made the run.
    """
    if run.experiment is None:
        raise ExperimentError(f"run '{run.name}' is of no experiment: it has no run folder")
    write_recorded(run.experiment, run.recording, folder)
    write_result(run, folder)


def write_recorded(experiment: Experiment, recording: Recording, folder: Path) -> None:
    """Write a run folder without its result: what has been measured is safe from here on.

    Args:
        experiment: What was carried out.
        recording: What was measured.
        folder: Where to; an older run is replaced at once.
    """
    with replacing(folder, folder=True) as fresh:
        fresh.mkdir()
        model = copy_model(Path(experiment.model), fresh / MODEL).relative_to(fresh)
        changed: dict[str, object] = {"model": model.as_posix()}
        if experiment.motion.file:
            shutil.copyfile(experiment.motion.file, fresh / MOTION)
            changed["motion"] = experiment.motion.model_copy(update={"file": MOTION})
        here = experiment.model_copy(update=changed)
        (fresh / EXPERIMENT).write_text(here.as_toml(), encoding="utf-8")
        recording.save(fresh / RECORDING)


def write_result(run: Run, folder: Path) -> None:
    """Write the result into a run folder that has its recording.

    Args:
        run: What came of it.
        folder: Its folder.
    """
    if run.unseen is not None:
        run.unseen.blind().save(folder / UNSEEN)
    result = result_of(run, _source(folder))
    write_estimates(result, folder / ESTIMATES)
    with replacing(folder / RESULT) as fresh:
        fresh.write_bytes(json_text(result.document()) + b"\n")


def _identity(experiment: Experiment) -> str:
    """Hash of an experiment and its model file's content.

    Raises:
        ModelError: There is no such model file.
    """
    path = Path(experiment.model)
    said = experiment.model_dump_json(exclude={"model": True, "motion": {"file"}})
    content = model_format(path) + fingerprint(path) + said
    if experiment.motion.file:
        content += fingerprint(Path(experiment.motion.file))
    return hashlib.sha256(content.encode()).hexdigest()


def _is_of(folder: Path, experiment: Experiment) -> bool:
    """Whether a run folder is of an experiment."""
    try:
        return _identity(Experiment.load(folder / EXPERIMENT)) == _identity(experiment)
    except (OSError, ExperimentError):  # unreadable, or its model file is gone
        return False


def read_run(folder: Path) -> Run:
    """A run folder's run, as it was when it was written.

    Estimates are made again where the folder has none, or was changed, or is of other versions;
    they are then not yet validated.

    Args:
        folder: The run folder.

    Raises:
        ExperimentError: It is no run folder, or the model file is not the run's.
    """
    missing = [name for name in (EXPERIMENT, RECORDING) if not (folder / name).is_file()]
    if missing:
        raise ExperimentError(f"'{folder}' is no run folder: it has no {', '.join(missing)}")
    experiment = Experiment.load(folder / EXPERIMENT)
    recording = Recording.load(folder / RECORDING)
    model = Path(experiment.model)
    if not model.is_file():
        raise ExperimentError(f"the run's model file '{model}' is not there any more")
    if fingerprint(model) != recording.facts.get("model_sha256"):
        raise ExperimentError(f"'{model}' is not the model that was simulated; run it again")
    bare = evaluate(experiment, recording, methods=())
    run = read_estimates(bare, folder / ESTIMATES, _source(folder))
    if run is None:
        return evaluate(experiment, recording)
    other = folder / UNSEEN
    return replace(run, unseen=Recording.load(other)) if other.is_file() else run


def _source(folder: Path) -> dict[str, str]:
    """All that estimates in a run folder came of: its files, and what computed them."""
    files = [name for name in (EXPERIMENT, RECORDING, UNSEEN) if (folder / name).is_file()]
    return versions() | {name: fingerprint(folder / name) for name in files}
