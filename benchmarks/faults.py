"""Wrong data on purpose: how wrong the estimates become, and whether anybody says so.

A minute of table6 with exact torque constants, one physical fault at a time. A fault is of one
method, and its error is that method's; the recording holds what both need, and whatever is said of
it counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.fault_trials import Trial, trials
from benchmarks.lines import print_lines
from testbed.core.base.diagnostics import Diagnostic, sentences
from testbed.core.base.errors import TestbedError
from testbed.core.estimation.diagnostics.torques import torque_scale_diagnostics
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.recording import Recording
from tests.helpers.paths import ROOT

MODEL = ROOT / "models/puma562.xml"

HARMFUL, SIGMAS = 0.02, 8.0
"""Relative error, and in sigmas, above which an estimate may not be silent."""

CAUSES: Mapping[str, str] = {
    "sign": "sign sign-of-tare sign-of-wrench encoder-sign",
    "tare": "sign-of-tare no-tare units-of-tare other-tare other-zero",
    "unit": "torques-in-n-mm moments-in-n-mm torques-in-lbf-ft wrench-in-lbf-ft wrench-in-lbf "
    "torques-in-lbf wrench-in-kgf torques-in-kgf-m degrees units-of-tare "
    "other-tare raw-units gain gains moments encoder-sign other-unit",
    "gain": "gains encoder_gains torque-constant gain torque_gain crosstalk",
    "drift": "slope drift plate.drift plate.offset",
    "channel": "saturated drive-limit not-connected other-column",
    "order": "exchanged",
    "clock": "skew clock_rate sampling encoder_delays torque_lag lost-samples clock",
    "pose": "pose moments height tilt",
    "zero": "joint_zeros zero frames",
    "model": "unmodelled-load pose joint_zeros encoder_gains frames tilt cable",
    "gravity": "gravity other-pedestal tilt",
}
"""Codes of which one should be among the first causes, by the kind of fault."""

OF_NOISE = ("encoder.noise", "encoder.resolution", "plate.offset", "plate.drift")
"""Codes of diagnostics that speak of faults, though sigma holds."""

NAMED = 3
"""First causes that a person looks at."""


def results(seconds: float) -> Iterator[dict[str, Any]]:
    """Every trial: the worst error, in sigmas too, and what is said about it."""
    tree = tb.load_tree(MODEL)
    recording = recorded(seconds)
    told = {m: tb.identify(tree, recording, m, zeros=True) for m in SIGNALS}
    yield from (_line(None, tree, m, told) for m in SIGNALS)
    for trial in trials(tree):
        changed = trial.change(recording)
        try:
            both = {m: tb.identify(trial.tree, changed, m, zeros=True) for m in SIGNALS}
        except TestbedError as error:
            said = {"fault": trial.fault, "method": trial.method, "refused": str(error)}
            yield {"kind": trial.kind, **said}
            continue
        yield _line(trial, tree, trial.method, both)


def total(lines: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """How many faults are noticed, of those that do harm."""
    faults = [line for line in lines if line.get("kind")]
    refused = [line for line in faults if "refused" in line]
    told = [line for line in faults if "refused" not in line]
    harmful = [x for x in told if x["error"] > HARMFUL and x["sigmas"] > SIGMAS]
    return {
        "trials": len(faults),
        "refused": len(refused),
        "harmful": len(harmful),
        "warned": sum(bool(line["warned"] or line["beside"]) for line in harmful),
        "named": sum(line["named"] for line in harmful),
        "silent": [_which(x) for x in harmful if not (x["warned"] or x["beside"])],
        "named_otherwise": [
            _which(x) for x in harmful if (x["warned"] or x["beside"]) and not x["named"]
        ],
    }


def _which(line: dict[str, Any]) -> str:
    return f"{line['fault']} ({line['method']})"


def recorded(seconds: float) -> Recording:
    """A recording with the noise of table6 and exact torque constants."""
    settings = [
        "seed=1996",
        f"motion.duration={seconds}",
        "motion.candidates=5",
        "measurement.torque_constant_error={}",
    ]
    experiment = tb.Experiment.from_toml(ROOT / "experiments/table6.toml", settings)
    found = tb.record(experiment.model_copy(update={"model": str(MODEL)}))
    return found.blind()


def _line(
    trial: Trial | None, tree: tb.Tree, method: Signal, both: Mapping[Signal, Estimate]
) -> dict[str, Any]:
    estimate = both[method]
    theta, drives = tb.barycentric(tree), estimate.drives
    minimal = estimate.minimal
    truth = minimal.values(theta) if drives is None else drives.values(theta, tree)
    error = np.abs(estimate.values - truth)
    warned = _said(estimate, both)
    beside = [each for m, other in both.items() if m != method for each in _said(other, {})]
    families = [each.family for other in both.values() for each in other.model_errors]
    kind = trial.kind if trial else ""
    return {
        "kind": kind,
        "fault": trial.fault if trial else "none",
        "method": method,
        "error": float(f"{(error / np.abs(truth))[: minimal.count].max():.3g}"),
        "sigmas": float(f"{(error / estimate.sigma).max():.3g}"),
        "named": _named(CAUSES[kind], warned + beside, families) if kind else None,
        "warned": sentences(warned),
        "beside": sentences(beside),
    }


def _named(codes: str, said: Sequence[Diagnostic], families: Sequence[str]) -> bool:
    """Whether one of the codes is a diagnostic's, a first cause's, or a family of model errors."""
    known = {*codes.split()}
    return any(known & {each.code, *each.causes[:NAMED], *families} for each in said)


def _said(estimate: Estimate, both: Mapping[Signal, Estimate]) -> list[Diagnostic]:
    """What is found in one method's data, and by comparing both methods."""
    found = [
        each
        for each in estimate.diagnostics
        if each.level == "error" or each.code in OF_NOISE or each.code.startswith("model-error")
    ]
    if len(both) == 2:
        found += torque_scale_diagnostics(both["wrench"], both["torque"])
    return found


def main(
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 60.0,
) -> None:
    """Wrong data: errors of the estimates, and who says so; exit code 1 if harm goes unnoticed."""
    found = total(print_lines(results(seconds)))
    print_lines([found])
    raise typer.Exit(int(bool(found["silent"])))
