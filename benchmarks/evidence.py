"""Planted causes, and what the check of joint torques against the robot's file makes of them.

Recordings are those of `planted_recordings`. An answer is right where the recording that its lines
make is the true one: positions but for zeros that no data tell, senses and order of torques, ratios
of gains, gravity, delay. It is silent where it proposes nothing, equal where it proposes another
cause and names the true one among those that explain as much, wrong otherwise.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.lines import print_lines
from benchmarks.mistakes import OPEN, recorded
from benchmarks.planted_recordings import ALL, KINDS, ROBOTS, Planted, cases
from testbed.core.base.diagnostics import sentences
from testbed.core.robot.gravity import parse_gravity
from testbed.importing.check.assessment import Assessment, assess_recording
from testbed.importing.check.remedies import Remedy, mapping_with_lines

ANGLE, SIGMAS = 3.0, 4.0
"""Error of gravity's direction that is good enough, the larger of both [deg, sigmas]."""

SIZE, GAIN = 0.1, 0.2
"""The same of gravity's size over 9.81 m/s^2, and of a gain, logarithm of its ratio to others."""

DELAY, MOMENT = 0.4, 2e-3
"""The same of a delay, the sum of a part of it and of a time [s]."""

DRIVES = 0.02
"""By so much real torques may be late by themselves [s]."""

GRAVITY = ("gravity", "gravity_removed")
"""Kinds of remedies that accuse gravity."""

WORDS = {"sign": "sign", "offset": "zero", "columns": "order", "gain": "size", "delay": "late"}
"""Of keys of a mapping that are wrong, in what is said to explain as much."""

RESULTS = ("right", "silent", "equal", "wrong")
MOST_WRONG = 0.01


def judged(case: Planted) -> dict[str, Any]:
    """What the check says first and proposes of a recording, and how good that is.

    Args:
        case: The recording.
    """
    start = time.process_time()
    found = assess_recording(case.tree, recorded(case.real, case.told))
    spent = time.process_time() - start
    lines = [line for remedy in found.remedies for line in remedy.lines]
    mapping = mapping_with_lines(case.told, lines)
    mapping |= mapping.pop("", {})  # keys above all tables
    kinds = {each.kind for each in found.remedies}
    close, error, sigma = _gravity(case, mapping, found)
    close = close and ("gravity_removed" in kinds) == case.removed
    close = close and _same_signals(case, mapping)
    close = close and _same_gains(case, mapping, found, changed="torque_size" in kinds)
    late = _same_delay(case, mapping)
    return {
        "robot": case.robot, "kind": case.kind, "planted": case.what,
        "result": "silent" if close and not late and "delay" not in kinds
        else _result(case, found, close and late),
        "proposed": [_in_words(each) for each in found.remedies],
        "first": next(iter(sentences(found.diagnostics[:1])), ""),
        "equals": list(found.equivalent_explanations),
        "gravity_deg": error, "sigma_deg": sigma,
        "accused": bool(kinds & {*GRAVITY}) if case.level else None,
        "currents": "gain" in case.told["torque"], "velocity": "velocity" in case.told,
        "seconds": round(float(np.ptp(case.real.time)), 1), "cpu_s": round(spent, 2),
    }  # fmt: skip


def _result(case: Planted, found: Assessment, close: bool) -> str:
    """One of `RESULTS`; `close`: whether the recording is the true one with what is proposed."""
    if not found.remedies:
        return "right" if close and not found.errors else "silent"
    return "right" if close else "equal" if _among_equals(case, found) else "wrong"


def _among_equals(case: Planted, found: Assessment) -> bool:
    """Whether the true cause is among what is said to explain as much as what is proposed."""
    text = " ".join(sentences(found.diagnostics))
    text = " ".join([*found.equivalent_explanations, *(text.partition(word)[2] for word in OPEN)])
    true = set() if case.level else {"gravity"}
    for table in (each for each in ALL if each in case.told):
        for key, word in WORDS.items():
            told, right = (each[table].get(key) or None for each in (case.told, case.right))
            if told != right and (key != "gain" or case.what == "factor"):
                lists = (told, right) if isinstance(told, list) else ((), ())
                pairs = zip(case.tree.names, *lists, strict=False)
                joints = {name for name, one, other in pairs if one != other}
                true |= {word} | (joints if len(joints) < case.tree.n else set())
    return bool(true) and all(each in text for each in true)


def _gravity(
    case: Planted, mapping: dict[str, Any], found: Assessment
) -> tuple[bool, float | None, float | None]:
    """Whether gravity is the true one; error and sigma of its direction, if proposed [deg]."""
    made = np.array(parse_gravity(mapping.get("gravity", case.tree.gravity)), float)
    true = np.array(case.right["gravity"])
    close = bool(abs(np.linalg.norm(made) - np.linalg.norm(true)) < SIZE * 9.81)
    proposed = [each for each in found.remedies if each.kind == "gravity"]
    sigmas = [getattr(each, "sigma", None) for each in proposed]
    sigma = next((float(np.max(each)) for each in sigmas if each is not None), None)
    if not made.any() or not true.any():
        return close, None, sigma
    error = float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(made, true)), made @ true)))
    close = close and error < max(ANGLE, SIGMAS * (sigma or 0.0))
    if not proposed:  # an inclination below the limit counts as not found
        return close and bool(np.allclose(made, true)), None, None
    return close, round(error, 3), sigma


def _same_signals(case: Planted, mapping: dict[str, Any]) -> bool:
    """Whether positions and columns of torques are the true ones, whatever the torques' sizes."""
    made, true = recorded(case.real, mapping), recorded(case.real, case.right)
    rest = made.position - true.position
    zero = (rest.mean(axis=0) + np.pi) % (2 * np.pi) - np.pi
    zero[-1] = 0  # no data tell
    if np.linalg.norm(np.cross(case.tree.joints[0].carried_axis, case.right["gravity"])) < 1e-6:
        zero[0] = 0
    one, other = made.measured("torque"), true.measured("torque")
    alike = (one * other).sum(axis=0) / np.sqrt((one**2).sum(axis=0) * (other**2).sum(axis=0))
    return bool(np.abs(zero).max() < 1e-3 and np.ptp(rest, axis=0).max() < 1e-4
                and alike.min() > 0.999)  # fmt: skip


def _same_gains(
    case: Planted, mapping: dict[str, Any], found: Assessment, *, changed: bool
) -> bool:
    """Whether gains that are said to be known have the true ratios, where they are changed."""
    if not changed and case.what != "factor":
        return True
    made, true, told = (np.array(each["torque"].get("gain", [1.0] * case.tree.n))
                        for each in (mapping, case.right, case.told))  # fmt: skip
    text = " ".join(sentences(found.diagnostics))
    known = (made != told) & [f"{name} " in text for name in case.tree.names]
    ratio = np.log(made / true)[known]
    return bool(known.any() and np.abs(ratio - np.median(ratio)).max() < GAIN)


def _same_delay(case: Planted, mapping: dict[str, Any]) -> bool:
    """Whether torques are as late as they are; real ones may be later."""
    made, true = (float(each["torque"].get("delay", 0.0)) for each in (mapping, case.right))
    if true and not made:
        return False
    least, most = (1 - DELAY) * true - MOMENT, (1 + DELAY) * true + MOMENT
    return least <= made <= most + DRIVES * (case.kind == "real")


def _in_words(remedy: Remedy) -> str:
    values = (f"{each:.4g}" if isinstance(each, float) else f"{each}" for each in remedy.values)
    return " ".join([remedy.kind, *remedy.joints, *values])


def total(lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Results by what was planted, gravity accused where it is right, its errors, CPU times.

    Args:
        lines: Of `judged`.
    """
    results: dict[str, list[int]] = {}
    for line in lines:
        counts = results.setdefault(f"{line['kind']}: {line['planted']}", [0] * len(RESULTS))
        counts[RESULTS.index(line["result"])] += 1
    right = [line for line in lines if line["accused"] is not None]
    found = [line for line in lines if line["gravity_deg"] is not None]
    errors = [line["gravity_deg"] for line in found if line["result"] == "right"]
    ratios = [line["gravity_deg"] / line["sigma_deg"] for line in found if line["sigma_deg"]]
    return {
        "benchmark": "evidence", "recordings": len(lines), "results": RESULTS,
        "planted": dict(sorted(results.items())),
        "all": np.sum([*results.values()], axis=0).tolist(),
        "gravity_accused": [sum(line["accused"] for line in right), len(right)],
        "gravity_deg": np.quantile(errors, [0.5, 1]).round(3).tolist() if errors else None,
        "gravity_sigmas": np.quantile(ratios, [0.5, 0.95]).round(2).tolist() if ratios else None,
        "cpu_s": np.quantile([line["cpu_s"] for line in lines], [0.5, 0.95, 1]).tolist(),
    }  # fmt: skip


def main(
    robots: Annotated[str, typer.Option(help="Names, by commas; all if empty.")] = "",
    seed: Annotated[int, typer.Option(help="Of robots, motions and mistakes.")] = 0,
    kinds: Annotated[str, typer.Option(help="Of what is planted, by commas.")] = ",".join(KINDS),
    count: Annotated[int, typer.Option(help="Recordings at most, drawn at random; 0: all.")] = 0,
) -> None:
    """Causes planted in recordings of torques; exit code 1 if more than 1 % get another one."""
    names = robots.split(",") if robots else [*ROBOTS]
    todo = cases(names, kinds.split(","), seed)[: count or None]
    if not todo:
        raise typer.BadParameter(f"robots are {', '.join(ROBOTS)}; kinds are {', '.join(KINDS)}")
    found = total(print_lines({"seed": seed} | judged(make()) for make in todo))
    print_lines([found])
    raise typer.Exit(int(found["all"][RESULTS.index("wrong")] > MOST_WRONG * len(todo)))
