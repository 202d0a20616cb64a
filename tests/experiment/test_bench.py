"""bedplate-bench: what a tool is given, and how its answers are scored."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks import bench
from benchmarks.bench import Case, make, score
from benchmarks.rivals.case import read
from benchmarks.rivals.testbed import solve

CLEAN = [Case("puma", "white", 0), Case("puma", "white", 1)]
"""One simulated by testbed, one by Pinocchio's inverse dynamics alone."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("bench") / "set"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "SECONDS", 10.0)
        make(found, [*CLEAN, Case("puma", "white", 0, "late")], jobs=1)
    return found


def bodies(urdf: Path) -> dict[str, list[float]]:
    model = pin.buildModelFromUrdf(str(urdf))
    pairs = list(zip(model.names, model.inertias, strict=True))[1:]
    return {name: inertia.toDynamicParameters().tolist() for name, inertia in pairs}


def test_the_real_bodies_are_the_answer_and_those_handed_out_are_not(folder: Path) -> None:
    """Otherwise a tool is scored against another robot, or is handed the truth."""
    for case in CLEAN:
        real = bodies(folder / f"truth/puma-0{case.draw}.urdf")
        handed = bodies(folder / f"recordings/{case.name}/robot.urdf")
        for parameters, least, most in ((real, 0.0, 1e-6), (handed, 0.01, 1.0)):
            found = score(folder, {case.name: {"parameters": parameters}})["error"]
            assert least <= found["torque"]["puma white"] < most
            assert least <= found["wrench"]["puma white"] < most


def test_testbed_answers_and_its_intervals_hold(folder: Path) -> None:
    """The script of the comparison: an answer that is wrong or late here would blame the tool."""
    answers: dict[str, dict[str, object]] = {}
    for case in CLEAN:
        recorded = read(folder / "recordings" / case.name)
        for signal in ("torque", "wrench"):
            found = solve(recorded, signal)
            answers.setdefault(case.name, {})[signal] = found["prediction"]
            answers[case.name][f"{signal}_sigma"] = found["sigma"]
    scored = score(folder, answers)
    for signal in ("torque", "wrench"):
        assert scored["error"][signal]["puma white"] < 0.004
        assert scored["coverage"][signal]["puma white"] > 0.8


def test_intervals_and_words_are_counted(folder: Path) -> None:
    """An interval of 1.96 sigma holds what is 1.9 off; words count that the clean one lacks."""
    name = CLEAN[0].name
    true = np.array(json.loads((folder / f"truth/{name}.json").read_text())["torque"])
    for off, share in ((1.9, 1.0), (2.0, 0.0)):
        answer = {"torque": true + off, "torque_sigma": np.ones_like(true)}
        assert score(folder, {name: answer})["coverage"]["torque"]["puma white"] == share
    late = Case("puma", "white", 0, "late").name
    for said, noticed in ((["one", "two"], [late]), (["one"], [])):
        answers = {name: {"said": ["one"]}, late: {"said": said}}
        assert score(folder, answers)["noticed"] == noticed
