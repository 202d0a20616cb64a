"""A folder of all that commands read, made once: nothing here may change it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.lab.experiment.results import write_run
from testbed.lab.experiment.run import Run
from tests.helpers.campaigns import NOISES, campaign_file
from tests.helpers.command import command_line
from tests.helpers.foreign_files import csv, some_log
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot
from tests.helpers.runs import MODELS, robot, without
from tests.scenarios.scenarios import result

PUMA = "puma562.xml"

TWO = random_robot(np.random.default_rng(0), 2).urdf()
MIMIC = TWO.replace('<child link="j2_body"/>', '<child link="j2_body"/><mimic joint="j1"/>')
"""A robot of two joints, and one whose second joint follows the first."""


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Robots, recordings with and without a signal, a run, what was identified, other files."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(MODELS["puma"], folder / PUMA)
    shutil.copy(GOLDEN / "robots/ur5.urdf", folder / "ur5.urdf")
    (folder / "two.urdf").write_text(TWO)
    (folder / "mimic.urdf").write_text(MIMIC)
    text = (ROOT / "experiments/table6.toml").read_text()
    (folder / "table.toml").write_text(text.replace("../models/", ""))
    campaign_file(folder, 2, NOISES)
    (folder / "map.toml").write_text(csv(folder, some_log()))
    run: Run = result("puma")
    write_run(run, folder / "run")
    found: tb.Recording = run.recording
    found.save(folder / "one.parquet")
    commands = np.roll(found.measured("torque"), -10, axis=0)
    replace(found, torque=commands).save(folder / "ahead.parquet")
    measured(robot("puma"), 2, duration=8.0).save(folder / "other.parquet")
    for signal in ("torque", "wrench"):
        without(found, signal).save(folder / f"no_{signal}.parquet")
    words = ("identify", "one.parquet", "--model", PUMA, "--zeros", "--json")
    (folder / "result.json").write_text(command_line(*words, cwd=folder).stdout)
    return folder
