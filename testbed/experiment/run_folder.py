"""A run folder: everything needed to repeat a run and to read its result.

experiment.toml   the experiment, every default written out
recording.parquet what was measured (and, apart, what happened)
result.json       estimates, truth, metrics, verdicts, versions
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from testbed.errors import ExperimentError
from testbed.experiment.carry_out import Outcome, evaluate, robot_of, versions
from testbed.experiment.experiment import Experiment
from testbed.experiment.score import Errors
from testbed.files import fingerprint, replacing
from testbed.identification.estimate import Estimate
from testbed.recordings.recording import Recording

FILES = ("experiment.toml", "recording.parquet", "result.json")
"""What a run folder holds."""


def run_folder(experiment: Experiment) -> Path:
    """runs/NAME-HASH, the hash over the experiment and the model file's content."""
    model = fingerprint(Path(experiment.model))
    content = experiment.model_dump_json(exclude={"model"}) + model
    return Path("runs") / f"{experiment.name}-{hashlib.sha256(content.encode()).hexdigest()[:8]}"


def check_folder(folder: Path) -> None:
    """Whether a run may be written there: a new place, or a run folder to be replaced.

    Raises:
        ExperimentError: Something else is there.
    """
    if folder.is_dir():
        present = {p.name for p in folder.iterdir()}
        others = sorted(present - set(FILES)) or sorted(present)
        if present and present != set(FILES):
            raise ExperimentError(
                f"'{folder}' is no run folder: it holds {', '.join(others[:3])}"
                f"{' ...' if len(others) > 3 else ''}; name another with --out"
            )
    elif folder.exists():
        raise ExperimentError(f"'{folder}' is a file; name a folder with --out")


def write_run(outcome: Outcome, folder: Path) -> None:
    """Write the run folder, whole or not at all; an older one is replaced.

    Raises:
        ExperimentError: Something that is no run is there.
    """
    check_folder(folder)
    with replacing(folder, folder=True) as fresh:
        fresh.mkdir()
        (fresh / "experiment.toml").write_text(outcome.experiment.as_toml(), encoding="utf-8")
        outcome.recording.save(fresh / "recording.parquet")
        text = json.dumps(result(outcome), indent=1, sort_keys=True)
        (fresh / "result.json").write_text(text + "\n", encoding="utf-8")


def read_run(folder: Path) -> Outcome:
    """A run folder as it was when it was written: the estimates are made again.

    Args:
        folder: The run folder.

    Raises:
        ExperimentError: It is no run folder, or the model file is not the run's.
    """
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        raise ExperimentError(f"'{folder}' is no run folder: it has no {', '.join(missing)}")
    experiment = Experiment.load(folder / "experiment.toml")
    recording = Recording.load(folder / "recording.parquet")
    model = Path(experiment.model)
    if not model.is_file():
        raise ExperimentError(f"the run's model file '{model}' is not there any more")
    if fingerprint(model) != recording.facts.get("model_sha256"):
        raise ExperimentError(f"'{model}' has changed since the run was made; run it again")
    return evaluate(experiment, robot_of(experiment), recording)


def result(outcome: Outcome) -> dict[str, Any]:
    """The outcome without its recording, as JSON takes it."""
    comparison = outcome.comparison
    return {
        "name": outcome.experiment.name,
        "claim": outcome.experiment.claim,
        "external": estimate_as_json(outcome.external) | _errors(comparison.external),
        "internal": estimate_as_json(outcome.internal) | _errors(comparison.internal),
        "metrics": dict(comparison.metrics),
        "expect": {
            k: b.model_dump(exclude_none=True) for k, b in outcome.experiment.expect.items()
        },
        "verdicts": dict(outcome.verdicts),
        "as_expected": outcome.as_expected,
        "warnings": list(outcome.warnings),
        "model_sha256": outcome.recording.facts["model_sha256"],
        "versions": versions(),
    }


def estimate_as_json(estimate: Estimate) -> dict[str, Any]:
    """An estimate as JSON takes it."""
    return {
        "method": estimate.method,
        "names": list(estimate.names),
        "units": list(estimate.units),
        "values": estimate.values.tolist(),
        "sigma": estimate.sigma.tolist(),
        "covariance": estimate.covariance.tolist(),
        "count": len(estimate.base.names),
        "channels": list(estimate.channels),
        "residual": estimate.residual.tolist(),
        "relative_residual": estimate.relative_residual.tolist(),
        "samples": list(estimate.samples),
        "condition": estimate.condition,
        "warnings": list(estimate.warnings),
    }


def _errors(errors: Errors) -> dict[str, Any]:
    return {
        "truth": errors.truth.tolist(),
        "relative_error": errors.relative.tolist(),
        "z": errors.z.tolist(),
    }
