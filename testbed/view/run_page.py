"""A run as a page that one can send, and its numbers as JSON beside it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import plural
from testbed.core.base.files import replacing, together
from testbed.core.base.installation import versions
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.identifiability import identifiability
from testbed.core.parameters.symbols import STANDARD
from testbed.core.recordings.recording import Recording
from testbed.core.robot.free_base import FREE
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.predict import predict
from testbed.lab.experiment.results import read_run
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import obtained, summary, verdict
from testbed.view.estimates import choice_lines, instrument_tables, parameter_tables
from testbed.view.figures import Panel
from testbed.view.minimal_sets import GLYPHS
from testbed.view.output import rendered
from testbed.view.plot import dots_section
from testbed.view.posterior import errors_table, posterior_table
from testbed.view.section import Table
from testbed.view.signals import sections

SIGNALS = {
    "position": "joint positions",
    "base": "pose of the base",
    "wrench": "bedplate wrench",
    "torque": "joint torques",
    "velocity": "velocities",
    "acceleration": "accelerations",
}
"""What was recorded, in words."""


def write_report(run: Run, path: Path) -> Path:
    """Write a report, and its numbers beside it.

    Args:
        run: What it is about.
        path: The HTML file.

    Returns:
        The JSON file: of the same name, ending in .json.
    """
    content = contents(run)
    text = rendered("report.html", content)
    beside = path.with_suffix(".json")
    with together(), replacing(path) as fresh, replacing(beside) as numbers:
        fresh.write_text(text, encoding="utf-8")
        numbers.write_text(
            json.dumps(_numbers(content), indent=1, sort_keys=True) + "\n", "utf-8"
        )
    return beside


def report(
    run: Run | str | Path, path: str | Path, unseen: Recording | None = None
) -> Path:
    """Write a report: one HTML file that needs nothing else, and its numbers as JSON beside it.

    Args:
        run: A run, or the folder of one.
        path: The HTML file.
        unseen: Another recording of the robot, on which predictions are shown; default that of the
            run's validation, else the run's own.

    Returns:
        The HTML file.

    Raises:
        ExperimentError: The folder holds no run.
        OSError: The file cannot be written there.
    """
    page = Path(path)
    what = run if isinstance(run, Run) else read_run(Path(run))
    write_report(what if unseen is None else replace(what, unseen=unseen), page)
    return page


def _numbers(content: Any) -> Any:
    """The page's data as JSON holds them: of drawings the titles."""
    if isinstance(content, Panel):
        return {"title": content.title}
    if is_dataclass(content):
        content = vars(content)
    if isinstance(content, Mapping):
        return {key: _numbers(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_numbers(value) for value in content]
    return content


def contents(run: Run) -> dict[str, Any]:
    """Everything that the page shows, and the numbers of the estimates.

    Args:
        run: What the report is about.
    """
    experiment = run.experiment
    estimates = [*run.estimates.values()]
    return {
        "title": run.name,
        "claim": "" if experiment is None else experiment.claim,
        "summary": summary(run),
        "verdict": verdict(run),
        "holds": run.as_expected,
        "claims": _claims(run),
        "diagnostics": sentences(run.diagnostics),
        "errors": dots_section(run),
        "parameters": next(parameter_tables(estimates, run.truths))
        if estimates
        else [],
        "estimates": {each.method: _values(each) for each in estimates},
        "figures": sections(predict(run, run.unseen)),
        "posterior": _posterior_tables(run),
        "instrument": instrument_tables(run),
        "maps": _maps(run),
        "zeros": bool(run.settings.zeros),
        "settings": _settings(run),
        "experiment": "" if experiment is None else _without_folders(experiment),
    }


def _values(estimate: Estimate) -> dict[str, Any]:
    """Value, standard deviation and unit of each identifiable parameter, by name."""
    numbers = estimate.values.tolist(), estimate.sigma.tolist()
    rows = zip(estimate.names, *numbers, estimate.units, strict=True)
    return {
        name: {"value": value, "sigma": sigma, "unit": unit}
        for name, value, sigma, unit in rows
        if name not in estimate.unidentifiable
    }


def _claims(run: Run) -> Table | None:
    """Bounds of the experiment beside the metrics; None without any."""
    expect = {} if run.experiment is None else run.experiment.expect
    rows = [
        [
            name.replace("_", " "),
            bound.wanted,
            obtained(run, name),
            "yes" if run.verdicts[name] else "no",
        ]
        for name, bound in expect.items()
    ]
    return Table(["figure", "claimed", "obtained", "holds"], rows) if rows else None


def _posterior_tables(run: Run) -> list[Table]:
    """What an imported recording adds to its model file, and errors on held-out data."""
    made, found = run.posterior.values(), run.validation.values()
    errors = [errors for each in made for errors in each.errors]
    errors += [each.errors for each in found if each.errors is not None]
    shares = [posterior_table(each) for each in made if each.used]
    return [*(errors_table(each) for each in errors), *shares]


def _maps(run: Run) -> list[Table]:
    """Which of each link's ten parameters joint torques, and a force plate, can identify."""
    tree = run.tree
    names = [*tree.names]
    if tree.floating:
        names[:FREE] = [joint.body for joint in tree.joints[:FREE]]
    last = 2 if tree.floating or run.recording.wrench is not None else 1
    maps = identifiability(tree, zeros=run.settings.zeros)[
        1 if tree.floating else 0 : last
    ]
    return [
        Table(
            ["body", *STANDARD],
            [
                [name, *(GLYPHS[code] for code in codes)]
                for name, codes in list(zip(names, each.standard, strict=True))[
                    tree.massless :
                ]
            ],
            f"{each.instrument}: {plural(each.count, 'combination')}",
        )
        for each in maps
    ]


def _settings(run: Run) -> dict[str, str]:
    """Robot, recording, identification and versions, in words."""
    tree, recording = run.tree, run.recording
    joints = tree.names[FREE:] if tree.floating else tree.names
    fitted = vars(run.settings.fitted(recording.rate))
    facts = {
        "robot": f"{tree.name}, {plural(len(joints), 'joint')}: {', '.join(joints)}",
        "gravity": f"{' '.join(f'{each:g}' for each in tree.gravity)} m/s^2",
        "recording": f"{np.ptp(recording.time):.4g} s, {recording.rate:.5g} samples a second",
        "measured": ", ".join(_measured(run)),
        "terms": "; ".join(choice_lines(run.estimates.values())),
        "identification": ", ".join(
            f"{name} {value}" for name, value in fitted.items() if value
        ),
        "versions": ", ".join(
            f"{name} {number}" for name, number in versions().items()
        ),
        "model's SHA-256": recording.metadata.model_sha256,
    }
    if run.model is not None:
        held = run.model.lock.items()
        facts["model file"] = run.model.path.name
        facts["held"] = ", ".join(
            joint if q is None else f"{joint} at {q:g}" for joint, q in held
        )
    return {name: text for name, text in facts.items() if text}


def _measured(run: Run) -> Iterator[str]:
    """Names of the recorded signals."""
    for key, label in SIGNALS.items():
        if run.tree.floating if key == "base" else key in run.recording.signals:
            yield label


def _without_folders(experiment: Experiment) -> str:
    """The experiment's file, its model without folders: the page is for sending."""
    model = Path(experiment.model).name
    return experiment.model_copy(update={"model": model}).as_toml()
