"""A run as a page that one can send, and its numbers as JSON beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.bodies.shapes.appearance import Appearance, load_appearance
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import plural
from testbed.core.base.files import replacing, together
from testbed.core.base.installation import versions
from testbed.core.base.summary_table import OPEN_ZERO
from testbed.core.dynamics.newton_euler import sensor_poses
from testbed.core.estimation.estimate import Estimate, by_influence
from testbed.core.parameters.identifiability import identifiability
from testbed.core.parameters.symbols import STANDARD
from testbed.core.recordings.recording import Recording
from testbed.core.robot.free_base import FREE
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import MotionTable
from testbed.lab.experiment.predict import predict
from testbed.lab.experiment.results import read_run
from testbed.lab.experiment.run import Run
from testbed.lab.experiment.summary import obtained, summary, verdict
from testbed.view.estimates import choice_lines, instrument_tables, matrix_maps, with_sigma
from testbed.view.figures import Panel
from testbed.view.output import rendered
from testbed.view.plot import dots_section
from testbed.view.portrait import portrait
from testbed.view.posterior import errors_table, posterior_table
from testbed.view.section import Drawing, Table
from testbed.view.signals import SHOWN, seconds_shown, sections

GLYPHS = ("·", "+", "#")
KINDS = ("never", "combined", "alone")
SAYS = ("never", "only in combination", "alone")

WIDEST = 5.0
"""Errors in sigmas that fill half a bar."""

LONGEST = 21
"""Characters of a value and its sigma with a sign between them; longer, sigma is in brackets."""

Lines = list[tuple[str, str]]


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
            json.dumps(_without_drawings(content), indent=1, sort_keys=True) + "\n", "utf-8"
        )
    return beside


def report(run: Run | str | Path, path: str | Path, unseen: Recording | None = None) -> Path:
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


def _without_drawings(content: Any) -> Any:
    """The page's data alone."""
    if isinstance(content, dict):
        return {key: _without_drawings(value) for key, value in content.items() if key != "svg"}
    if isinstance(content, Panel | Drawing):
        return {"title": content.title}
    if is_dataclass(content):
        return _without_drawings(vars(content))
    if isinstance(content, list | tuple):
        return [_without_drawings(value) for value in content]
    return content


def contents(run: Run) -> dict[str, Any]:
    """Everything that the page shows; drawings know their "svg".

    Args:
        run: What the report is about.
    """
    look = load_appearance(run.tree, run.model)
    plate = run.recording.wrench is not None
    return {
        "title": run.name,
        "claim": "" if run.experiment is None else run.experiment.claim,
        "summary": summary(run),
        "verdict": verdict(run),
        "verdicts": _verdicts(run),
        "holds": run.as_expected,
        "portrait": _portrait(run, look),
        "asked": asked(run),
        "methods": list(run.estimates),
        "names": run.instruments,
        "has_truth": bool(run.truths),
        "parameters": parameter_rows(run),
        "in_brackets": _in_brackets(run),
        "diagnostics": sentences([*run.diagnostics, *look.diagnostics]),
        "errors": dots_section(run),
        "figures": sections(predict(run, run.unseen)),
        "posterior": _posterior_tables(run),
        "instrument": instrument_tables(run),
        "matrix": matrix_maps(run),
        "maps": _maps(run.tree, run.settings.zeros, plate=plate),
        "zeros": bool(run.settings.zeros),
        "origin": origin(run),
    }


def _posterior_tables(run: Run) -> list[Table]:
    """What an imported recording adds to its model file, and errors on held-out data."""
    made, found = run.posterior.values(), run.validation.values()
    errors = [errors for each in made for errors in each.errors]
    errors += [each.errors for each in found if each.errors is not None]
    shares = [posterior_table(each) for each in made if each.used]
    return [*(errors_table(each) for each in errors), *shares]


def _verdicts(run: Run) -> list[dict[str, Any]]:
    """Claims, and what came out."""
    expect = {} if run.experiment is None else run.experiment.expect
    return [
        {
            "name": name.replace("_", " "),
            "wanted": bound.wanted,
            "value": obtained(run, name),
            "holds": run.verdicts[name],
        }
        for name, bound in expect.items()
    ]


def _portrait(run: Run, look: Appearance) -> dict[str, str]:
    """The robot as the recording begins, with the reaction at that moment."""
    recording = run.recording
    shown = recording.time <= recording.time[0] + SHOWN
    step = max(1, int(shown.sum()) // 500)
    wrench = None if recording.wrench is None else recording.wrench[0]
    place, what = None, "bedplate"
    if wrench is not None and run.tree.sensor is not None:
        turn, place = (each[0] for each in sensor_poses(run.tree, recording.position[:1]))
        wrench, what = np.concatenate([turn @ wrench[:3], turn @ wrench[3:]]), "force sensor"
    name = f"The robot {run.tree.name}" + " on its bedplate" * (wrench is not None)
    paths = f"the paths of its ends over {seconds_shown(recording.time):.3g} s"
    caption = f"The robot as the recording begins, and {paths}."
    if wrench is not None:
        caption += (
            f" Red and blue, the {what}'s force and moment on it at that moment, about the "
            f"{what}'s origin."
        )
    motion = recording.position[shown][::step]
    return {"svg": portrait(look, motion, wrench, name, place), "caption": caption}


def parameter_rows(run: Run) -> list[dict[str, Any]]:
    """Every parameter by every method: first what adds most to the predicted signals.

    Args:
        run: The run.
    """
    units = {n: u for e in run.estimates.values() for n, u in zip(e.names, e.units, strict=True)}
    rows, short = [], _in_brackets(run)
    for name in by_influence(run.estimates.values(), run.truths):
        truth = run.truths.get(name)
        rows.append(
            {
                "name": name,
                "unit": units[name],
                "truth": "" if truth is None else f"{truth:.6g}",
                "cells": [_cell(e, name, truth, short) for e in run.estimates.values()],
            }
        )
    return rows


def _in_brackets(run: Run) -> bool:
    """Whether values would be too long for a page with their sigmas after a sign."""
    every = (
        with_sigma(e, name)
        for e in run.estimates.values()
        for name in e.names
        if name not in e.unidentifiable
    )
    return any(len(text.replace("+-", "±")) > LONGEST for text in every)


def _cell(estimate: Estimate, name: str, truth: float | None, short: bool) -> dict[str, Any]:
    """One method's value, and its error as a bar where the truth is known."""
    cell: dict[str, Any] = {
        "method": estimate.method,
        "text": with_sigma(estimate, name, short),
        "value": None,
        "sigma": None,
        "z": None,
    }
    if name not in estimate.names:
        return cell
    k = estimate.names.index(name)
    if name in estimate.unidentifiable:
        return cell | {"text": OPEN_ZERO}
    value, sigma = float(estimate.values[k]), float(estimate.sigma[k])
    cell |= {"value": value, "sigma": sigma}
    if truth is not None:
        z = (value - truth) / sigma if sigma > 0 else 0.0
        share = min(abs(z) / WIDEST, 1.0) * 50.0
        left = 50.0 if z > 0 else 50.0 - share
        cell |= {"z": z, "shown": f"{z:+.1f}", "left": round(left, 1), "width": round(share, 1)}
    return cell


def _maps(tree: Tree, zeros: bool | Sequence[str], *, plate: bool) -> list[dict[str, Any]]:
    """Which of each link's ten parameters joint torques, and a force plate, can identify."""
    tables = []
    maps = identifiability(tree, zeros=zeros)[: 2 if plate or tree.floating else 1]
    names = [*tree.names]
    if tree.floating:
        names[:FREE] = [joint.body for joint in tree.joints[:FREE]]
    for seen in maps[1:] if tree.floating else maps:
        rows = []
        beyond = slice(tree.massless, None)
        for name, codes in zip(names[beyond], seen.standard[beyond], strict=True):
            cells = [{"glyph": GLYPHS[k], "kind": KINDS[k], "says": SAYS[k]} for k in codes]
            rows.append((name, cells))
        title = f"{seen.instrument}: {plural(seen.count, 'combination')}"
        tables.append({"title": title, "names": STANDARD, "rows": rows})
    return tables


def asked(run: Run) -> Lines:
    """Robot, motion, instruments and how the signals were treated.

    Args:
        run: The run.
    """
    names = run.tree.names[FREE:] if run.tree.floating else run.tree.names
    joints = f"{plural(len(names), 'joint')}: {', '.join(names)}"
    base = ", on a base that moves and whose pose is measured" if run.tree.floating else ""
    gx, gy, gz = run.tree.gravity
    base_frame = "base" if run.recording.wrench is None else "bedplate"
    facts = [
        ("robot", f"{run.tree.name}{base}, {joints}"),
        ("gravity", f"{gx:g} {gy:g} {gz:g} m/s^2 in the {base_frame} frame"),
    ]
    if run.model is not None:
        facts.append(("model file", run.model.path.name))
        facts += [("held", held)] if (held := _held(run.model.lock)) else []
    facts += _of_recording(run) if run.experiment is None else _of_experiment(run.experiment)
    chosen = [("terms", line) for line in choice_lines(run.estimates.values())]
    return [*facts, ("identification", _treatment(run)), *chosen]


def _held(lock: Mapping[str, float | None]) -> str:
    """Joints that do not move in this run, and where they stand."""
    at = {joint: "where it rests" if q is None else f"at {q:g}" for joint, q in lock.items()}
    unit = " [rad or m]" if any(q is not None for q in lock.values()) else ""
    return ", ".join(f"{joint} {place}" for joint, place in at.items()) + unit


def _of_recording(run: Run) -> Lines:
    """What a recording says of itself."""
    recording = run.recording
    duration = float(recording.time[-1] - recording.time[0])
    signals = {
        "bedplate wrench": recording.wrench,
        "joint torques": recording.torque,
        "velocities": recording.velocity,
        "accelerations": recording.acceleration,
    }
    there = ["joint positions", *(["pose of the base"] if run.tree.floating else [])]
    there += [name for name, signal in signals.items() if signal is not None]
    return [
        ("recording", f"{duration:.4g} s, {recording.rate:.5g} samples a second"),
        ("measured", ", ".join(there)),
    ]


def _of_experiment(experiment: Experiment) -> Lines:
    """Motion, instruments and plant, as they were asked for."""
    motion, plate, plant = experiment.motion, experiment.measurement, experiment.simulation
    errors = ", ".join(f"{k} {v:+.0%}" for k, v in plate.torque_constant_error.items())
    return [
        ("motion", _motion(motion)),
        (
            "encoders",
            f"{plate.rate:g} samples a second, resolution {plate.encoder_resolution:g}, noise "
            f"{plate.encoder_noise:g} [rad or m]",
        ),
        ("wrench", f"noise {plate.force_noise:g} N and {plate.moment_noise:g} N m a sample"),
        ("faults", ", ".join(fault.kind for fault in plate.fault) or "none"),
        (
            "drives",
            f"torque noise {plate.torque_noise:g} [N m or N]"
            + (f", torque constants off by {errors}" if errors else ""),
        ),
        ("kinematics", "sensed exactly" if plate.senses_kinematics else "from encoders only"),
        ("joint friction", "as in the model file" if plant.friction else "none"),
        ("effects in the plant", ", ".join(effect.kind for effect in plant.effect) or "none"),
        (
            "simulation",
            f"steps of {plant.step:g} s; samples are "
            + ("means over their steps" if plate.averaged else "instants"),
        ),
    ]


def _treatment(run: Run) -> str:
    """How the signals became equations."""
    settings = run.settings.fitted(run.recording.rate)
    cutoffs = [
        cutoff if isinstance(cutoff, str) else f"{cutoff:g} Hz"
        for cutoff in (settings.position_cutoff, settings.cutoff)
    ]
    zeros = {True: "those that are zero in the model file", False: "none"}
    known = zeros[settings.zeros] if isinstance(settings.zeros, bool) else ", ".join(settings.zeros)
    unknown = f"; calibration parameters: {', '.join(settings.nuisances)}" * bool(
        settings.nuisances
    )
    dropped = f"joint rows below {settings.deadband:g} rad/s or m/s dropped; "
    return (
        f"low-pass on positions {cutoffs[0]}, on rows {cutoffs[1]}; "
        f"{'' if run.tree.floating else dropped}noise model: an autoregression; "
        f"parameters fixed to zero: {known}{unknown}"
    )


def origin(run: Run) -> Lines:
    """Files, versions, and how to repeat it.

    Args:
        run: The run.
    """
    facts = [("versions", ", ".join(f"{name} {number}" for name, number in versions().items()))]
    known = run.recording.facts
    if known.get("model_sha256"):
        facts.insert(0, ("model's SHA-256", str(known["model_sha256"])))
    if run.experiment is not None:
        facts.append(("seed", str(run.experiment.seed)))
        facts.append(("repeat, in the run folder", "testbed run experiment.toml"))
    return facts


def _motion(motion: MotionTable) -> str:
    rests = ", from rest to rest" if motion.at_rest else ""
    if motion.file:
        return f"{motion.duration:g} s of the one in {Path(motion.file).name}{rests}"
    return (
        f"{motion.duration:g} s, repeats at {motion.fundamental:g} Hz with {motion.harmonics} "
        f"harmonics, the best of {motion.candidates}{rests}"
    )
