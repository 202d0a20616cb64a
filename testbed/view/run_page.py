"""HTML report of a run, and JSON file with its numbers."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import count_with_noun
from testbed.core.base.files import atomic_output, replace_together
from testbed.core.base.installation import package_versions
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.identifiability import identifiability
from testbed.core.parameters.symbols import STANDARD_NAMES
from testbed.core.recordings.recording import Recording
from testbed.core.robot.free_base import N_BASE_COORDINATES
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.predict import predict
from testbed.lab.experiment.results import read_run
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import claim_verdict, metric_text, summary
from testbed.view.estimates import choice_lines, parameter_tables, sensor_error_tables
from testbed.view.figures import Panel
from testbed.view.minimal_sets import IDENTIFIABILITY_GLYPHS
from testbed.view.output import render_page
from testbed.view.plot import parameter_error_section
from testbed.view.posterior import posterior_table, prediction_error_table
from testbed.view.section import Table
from testbed.view.signals import sections

SIGNAL_LABELS = {
    "position": "joint positions",
    "base": "pose of the base",
    "wrench": "bedplate wrench",
    "torque": "joint torques",
    "velocity": "velocities",
    "acceleration": "accelerations",
}
"""Labels of recorded signals."""


def write_report(run: Run, path: Path) -> Path:
    """Write the HTML report of a run, and its numbers as JSON.

    If an error occurs, neither file is written.

    Args:
        run: Run of the report.
        path: The HTML file, replaced if it exists.

    Returns:
        The JSON file, which has the name of the HTML file with the extension .json.
    """
    content = report_contents(run)
    text = render_page("report.html", content)
    json_path = path.with_suffix(".json")
    with (
        replace_together(),
        atomic_output(path) as html_file,
        atomic_output(json_path) as json_file,
    ):
        html_file.write_text(text, encoding="utf-8")
        json_file.write_text(
            json.dumps(_json_values(content), indent=1, sort_keys=True) + "\n", "utf-8"
        )
    return json_path


def report(
    run: Run | str | Path, path: str | Path, unseen: Recording | None = None
) -> Path:
    """Write the HTML report of a run or run folder, and its numbers as JSON.

    The HTML file is self-contained. The JSON file has the same name with the extension .json.

    Args:
        run: A run, or the folder of a run.
        path: The HTML file.
        unseen: Another recording of the robot, for which predictions are shown; default the
            recording of the run's validation, or of the run if it was not validated.

    Returns:
        The HTML file.

    Raises:
        ExperimentError: The folder contains no run.
        OSError: The file cannot be written.
    """
    html_path = Path(path)
    source_run = run if isinstance(run, Run) else read_run(Path(run))
    write_report(
        source_run if unseen is None else replace(source_run, unseen=unseen), html_path
    )
    return html_path


def _json_values(content: Any) -> Any:
    """Convert template variables to JSON values.

    Dataclasses become mappings, and panels are represented by their titles.
    """
    if isinstance(content, Panel):
        return {"title": content.title}
    if is_dataclass(content):
        content = vars(content)
    if isinstance(content, Mapping):
        return {key: _json_values(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_json_values(value) for value in content]
    return content


def report_contents(run: Run) -> dict[str, Any]:
    """Template variables of the report: summary, tables, figures, settings of a run.

    Args:
        run: Run of the report.
    """
    experiment = run.experiment
    estimates = [*run.estimates.values()]
    return {
        "title": run.name,
        "claim": "" if experiment is None else experiment.claim,
        "summary": summary(run),
        "verdict": claim_verdict(run),
        "holds": run.as_expected,
        "claims": _claim_table(run),
        "diagnostics": sentences(run.diagnostics),
        "errors": parameter_error_section(run),
        "parameters": next(parameter_tables(estimates, run.truths))
        if estimates
        else [],
        "estimates": {
            estimate.method: _estimate_values(estimate) for estimate in estimates
        },
        "figures": sections(predict(run, run.unseen)),
        "posterior": _posterior_tables(run),
        "instrument": sensor_error_tables(run),
        "maps": _identifiability_tables(run),
        "zeros": bool(run.settings.zeros),
        "settings": _setting_texts(run),
        "experiment": "" if experiment is None else _toml_without_folders(experiment),
    }


def _estimate_values(estimate: Estimate) -> dict[str, Any]:
    """Value, standard deviation and unit of each identifiable parameter, keyed by name."""
    numbers = estimate.values.tolist(), estimate.sigma.tolist()
    rows = zip(estimate.names, *numbers, estimate.units, strict=True)
    return {
        name: {"value": value, "sigma": sigma, "unit": unit}
        for name, value, sigma, unit in rows
        if name not in estimate.unidentifiable
    }


def _claim_table(run: Run) -> Table | None:
    """Table with one row per bound of [expect]: metric, bound, value, and yes or no.

    The result is None if there are no bounds.
    """
    expect = {} if run.experiment is None else run.experiment.expect
    rows = [
        [
            name.replace("_", " "),
            bound.description,
            metric_text(run, name),
            "yes" if run.verdicts[name] else "no",
        ]
        for name, bound in expect.items()
    ]
    return Table(["figure", "claimed", "obtained", "holds"], rows) if rows else None


def _posterior_tables(run: Run) -> list[Table]:
    """Tables of prediction errors on held-out data, followed by a run's posteriors.

    There are prediction errors for each posterior and each validation. The values of a posterior
    are tabulated only if the data alone do not determine them (`Posterior.used`).
    """
    posteriors, validations = run.posterior.values(), run.validation.values()
    errors = [errors for each in posteriors for errors in each.errors]
    errors += [each.errors for each in validations if each.errors is not None]
    shares = [posterior_table(each) for each in posteriors if each.used]
    return [*(prediction_error_table(each) for each in errors), *shares]


def _identifiability_tables(run: Run) -> list[Table]:
    """Tables of the identifiability of the links' standard parameters, one per instrument.

    The instruments are the joint torques, and the force plate if its wrench was recorded. For a
    floating base, the only instrument is the wrench on the base.
    """
    tree = run.tree
    names = [*tree.names]
    if tree.floating:
        names[:N_BASE_COORDINATES] = [
            joint.body for joint in tree.joints[:N_BASE_COORDINATES]
        ]
    last = 2 if tree.floating or run.recording.wrench is not None else 1
    maps = identifiability(tree, zeros=run.settings.zeros)[
        1 if tree.floating else 0 : last
    ]
    return [
        Table(
            ["body", *STANDARD_NAMES],
            [
                [name, *(IDENTIFIABILITY_GLYPHS[code] for code in codes)]
                for name, codes in list(zip(names, each.standard, strict=True))[
                    tree.massless :
                ]
            ],
            f"{each.instrument}: {count_with_noun(each.count, 'combination')}",
        )
        for each in maps
    ]


def _setting_texts(run: Run) -> dict[str, str]:
    """Texts on robot, recording, identification and versions, keyed by label.

    Empty texts are left out.
    """
    tree, recording = run.tree, run.recording
    joints = tree.names[N_BASE_COORDINATES:] if tree.floating else tree.names
    fitted = vars(run.settings.fitted(recording.rate))
    texts = {
        "robot": f"{tree.name}, {count_with_noun(len(joints), 'joint')}: {', '.join(joints)}",
        "gravity": f"{' '.join(f'{each:g}' for each in tree.gravity)} m/s^2",
        "recording": f"{np.ptp(recording.time):.4g} s, {recording.rate:.5g} samples a second",
        "measured": ", ".join(_recorded_signal_labels(run)),
        "terms": "; ".join(choice_lines(run.estimates.values())),
        "identification": ", ".join(
            f"{name} {value}" for name, value in fitted.items() if value
        ),
        "versions": ", ".join(
            f"{name} {number}" for name, number in package_versions().items()
        ),
        "model's SHA-256": recording.metadata.model_sha256,
    }
    if run.model is not None:
        locked_joints = run.model.lock.items()
        texts["model file"] = run.model.path.name
        texts["held"] = ", ".join(
            joint if q is None else f"{joint} at {q:g}" for joint, q in locked_joints
        )
    return {name: text for name, text in texts.items() if text}


def _recorded_signal_labels(run: Run) -> Iterator[str]:
    """Yield the labels of the recorded signals, including the base pose of a floating robot."""
    for key, label in SIGNAL_LABELS.items():
        if run.tree.floating if key == "base" else key in run.recording.signals:
            yield label


def _toml_without_folders(experiment: Experiment) -> str:
    """TOML text of an experiment in which the model's path is only a file name.

    Reports are sent to other computers and should not disclose folder names.
    """
    model = Path(experiment.model).name
    return experiment.model_copy(update={"model": model}).as_toml()
