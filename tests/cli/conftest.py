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
from tests.helpers.runs import MODELS, robot, without
from tests.scenarios.scenarios import result

PUMA = "puma562.xml"

TWO = """<robot name="two"><link name="base"/>
  <link name="a"><inertial><origin xyz="0.3 0 0.1"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="b"><inertial><origin xyz="0.2 0.1 0"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="leads" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="90" velocity="2"/></joint>
  <joint name="follows" type="revolute"><origin xyz="0.5 0 0"/><parent link="a"/>
    <child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="50" velocity="2"/>MIMIC</joint></robot>"""
"""A robot of two joints; the second may follow the first."""


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Robots, recordings with and without a signal, a run, what was identified, other files."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(MODELS["puma"], folder / PUMA)
    shutil.copy(GOLDEN / "robots/ur5.urdf", folder / "ur5.urdf")
    (folder / "two.urdf").write_text(TWO.replace("MIMIC", ""))
    (folder / "mimic.urdf").write_text(TWO.replace("MIMIC", '<mimic joint="leads"/>'))
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
