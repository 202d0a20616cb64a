"""A run as JSON takes it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.experiment.consistent_results import consistent_as_json
from testbed.experiment.drive_results import drives_as_json
from testbed.experiment.experiment import RecordingTables
from testbed.experiment.run import Run
from testbed.experiment.score import Errors
from testbed.experiment.versions import versions
from testbed.files import fingerprint
from testbed.identification.estimate import Estimate
from testbed.identification.held_out import TermChoice
from testbed.identification.term_choice import as_settled
from testbed.identification.validate import Validation
from testbed.robot.model_file import ModelFile


def result(run: Run) -> dict[str, Any]:
    """A run without its recording, as JSON takes it."""
    experiment = run.experiment
    expect = {} if experiment is None else experiment.expect
    errors = {} if run.score is None else run.score.errors
    accuracy = {} if run.score is None else run.score.accuracy
    return {
        "name": run.name,
        "claim": "" if experiment is None else experiment.claim,
        **{
            method: estimate_as_json(estimate) | _errors(errors.get(method))
            for method, estimate in run.estimates.items()
        },
        "failures": dict(run.failures),
        "metrics": dict(run.metrics),
        "accuracy": {method: asdict(found) for method, found in accuracy.items()},
        "expect": {k: b.model_dump(exclude_none=True) for k, b in expect.items()},
        "verdicts": run.verdicts,
        "as_expected": run.as_expected,
        "diagnostics": [each.as_dict() for each in run.diagnostics],
        "drives": None if run.drives is None else drives_as_json(run.drives),
        "consistent": None if run.consistent is None else consistent_as_json(run.consistent),
        "validation": {m: validation_as_json(found) for m, found in run.validation.items()},
        "model_sha256": run.recording.facts.get("model_sha256"),
        "versions": versions(),
    }


def estimate_as_json(estimate: Estimate) -> dict[str, Any]:
    """An estimate as JSON takes it."""
    return {
        "method": estimate.method,
        "names": list(estimate.names),
        "units": list(estimate.units),
        "values": estimate.values.tolist(),
        "sigma": _finite(estimate.sigma),
        "unidentifiable": list(estimate.unidentifiable),
        "covariance": estimate.covariance.tolist(),
        "gravity": estimate.gravity.tolist(),
        "count": len(estimate.base.names),
        "channels": list(estimate.channels),
        "residual": estimate.residual.tolist(),
        "relative_residual": estimate.relative_residual.tolist(),
        "samples": list(estimate.samples),
        "condition": estimate.condition,
        "noise": _noise(estimate),
        "nuisances": nuisances_as_json(estimate),
        "trace_tests": [
            {
                "kind": t.nuisance.kind,
                "chance": t.chance,
                "names": list(t.names),
                "units": list(t.units),
                "size": list(t.size),
                "parameter": t.parameter,
                "shift": t.shift,
            }
            for t in estimate.trace_tests
        ],
        "choice": choice_as_json(estimate.choice),
        "doubtful": estimate.doubtful,
        "diagnostics": [each.as_dict() for each in estimate.diagnostics],
    }


def nuisances_as_json(estimate: Estimate) -> list[dict[str, Any]]:
    """Numbers of the instrument as JSON takes them."""
    return [
        {"name": n.name, "unit": n.unit, "value": n.value, "sigma": n.sigma}
        for n in estimate.nuisances
    ]


def _noise(estimate: Estimate) -> dict[str, Any] | None:
    """What the residuals are like; null where they are taken as white."""
    noise = estimate.noise
    if noise is None:
        return None
    return {
        "order": noise.order,
        "memory": list(noise.memory),
        "factor": noise.factor,
        "bias": noise.bias.tolist(),
        "bias_sigma": noise.bias_sigma.tolist(),
        "bias_chance": noise.bias_chance,
        "bias_weight": noise.bias_weight,
        "hidden": list(noise.hidden),
        "drowned": list(noise.drowned),
        "least_counts": list(noise.least_counts),
        "by_counts": noise.by_counts,
        "repetition": None if noise.repetition is None else asdict(noise.repetition),
    }


def identified_as_json(
    estimates: Iterable[Estimate], model: ModelFile, tables: RecordingTables
) -> dict[str, Any]:
    """Estimates of a recording by method, and what is needed to make their robot again.

    Args:
        estimates: By one method or by both.
        model: The model file, and how it was read.
        tables: What else was said of robot and identification.
    """
    estimates = list(estimates)
    settings = _settled(tables, estimates).model_dump(mode="json", exclude_none=True)
    for key in ("lock", "lock_mimic"):  # the model's lock is all that was held
        settings["robot"].pop(key)
    return {
        **{estimate.method: estimate_as_json(estimate) for estimate in estimates},
        "model": {
            "path": str(model.path),
            "sha256": fingerprint(model.path),
            "weld_root": model.weld_root,
            "lock": dict(model.lock),
        },
        "settings": settings,
    }


def _settled(tables: RecordingTables, estimates: list[Estimate]) -> RecordingTables:
    """The same with the terms and the shafts that the estimates have."""
    robot = tables.robot
    for drives in (estimate.drives for estimate in estimates):
        if drives is not None and drives.tree.shafts:
            names = drives.tree.names
            said = {s.name: {names[j]: turn for j, turn in s.turns} for s in drives.tree.shafts}
            robot = robot.model_copy(update={"coupling": said})
    identification = as_settled(tables.identification, estimates)
    return tables.model_copy(update={"robot": robot, "identification": identification})


def choice_as_json(choice: TermChoice | None) -> dict[str, Any] | None:
    """How held-out data chose terms, as JSON takes it; null where they did not."""
    if choice is None:
        return None
    found = choice.growth
    return {
        "terms": list(choice.words),
        "parts": choice.parts,
        "steps": [asdict(step) for step in found.steps],
        "next_best": None if found.next_best is None else asdict(found.next_best),
        "held_out": {
            which: {"rms": each.rms, "residual": each.residual.tolist()}
            for which, each in (("before", choice.before), ("after", choice.after))
        },
    }


def validation_as_json(found: Validation) -> dict[str, Any]:
    """A validation as JSON takes it: null where there is no number."""
    numbers = {
        "signal": found.signal,
        "residual": found.residual,
        "relative_residual": found.relative_residual,
        "mean": found.mean,
        "noise": found.noise,
        "spread": found.spread,
        "ratio": found.ratio,
    }
    return {
        "channels": list(found.channels),
        "units": list(found.units),
        "rows": list(found.rows),
        **{name: _finite(values) for name, values in numbers.items()},
        "diagnostics": [each.as_dict() for each in found.diagnostics],
    }


def _errors(errors: Errors | None) -> dict[str, Any]:
    """Errors as JSON takes them: null where there is no number."""
    if errors is None:
        return {}
    numbers = {"truth": errors.truth, "relative_error": errors.relative, "z": errors.z}
    return {name: _finite(values) for name, values in numbers.items()}


def _finite(values: Array) -> list[float | None]:
    return [x if np.isfinite(x) else None for x in values.tolist()]
