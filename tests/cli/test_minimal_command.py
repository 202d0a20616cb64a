"""`testbed minimal`: what is asked for is shown, checked as shown, and fits."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import testbed.cli.models  # registers the commands
from testbed.cli.options import app
from testbed.errors import UnknownName
from tests.helpers.paths import REAL, ROOT
from tests.helpers.robots import random_robot

PUMA = str(ROOT / "models/puma562.urdf")
UR5 = str(REAL / "ur_description/urdf/ur5_robot.urdf")
assert testbed.cli.models


def minimal(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["minimal", *arguments])


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A robot of sixty joints."""
    path: Path = tmp_path_factory.mktemp("large") / "sixty.urdf"
    path.write_text(random_robot(np.random.default_rng(0), 60).urdf())
    return str(path)


def test_terms_are_told_by_name() -> None:
    done = minimal(PUMA, "--terms", "rotor", "--terms", "offset")
    assert done.exit_code == 0
    assert "rotor/waist: told only within K*1zz+rotor/waist" in done.stdout
    assert "rotor: a column of its own for elbow" in done.stdout
    assert "offset: a column of its own for every joint" in done.stdout
    assert "with terms of the joints, 19 unknowns" in done.stdout


def test_terms_are_in_the_document() -> None:
    document = json.loads(minimal(PUMA, "--terms", "rotor", "--json").stdout)
    assert document["drives"]["own"] == ["rotor/elbow"]
    assert set(document["drives"]["regrouped"]) == {"rotor/waist", "rotor/shoulder"}
    assert len(document["drives"]["names"]) == 16
    assert "drives" not in json.loads(minimal(PUMA, "--json").stdout)


def test_an_unknown_term_is_named_with_those_known() -> None:
    done = minimal(PUMA, "--terms", "rotro")
    assert isinstance(done.exception, UnknownName)
    assert "did you mean 'rotor'? (known: coulomb" in str(done.exception)


def test_what_is_verified_is_what_is_shown() -> None:
    """UR5 with its file's zeros: 16 and 18, not the general sets."""
    done = minimal(UR5, "--zeros", "--terms", "rotor", "--verify")
    assert done.exit_code == 0
    assert "dynamic: three witnesses agree: rules 16, exact recursion 16" in done.stdout
    assert "reaction: three witnesses agree: rules 18, exact recursion 18" in done.stdout
    assert "two witnesses agree: exact recursion 20, sampled columns 20" in done.stdout
    verified = json.loads(minimal(UR5, "--zeros", "--verify", "--json").stdout)["verified"]
    assert [each["rules"] for each in verified] == [16, 18]


def test_the_tared_plate_and_given_zeros() -> None:
    done = minimal(PUMA, "--tared", "--zero", "mb3x", "--zero", "K3xy", "--verify")
    assert done.exit_code == 0
    assert "tell 13 combinations and the tared bedplate 17" in done.stdout


def test_large_matrices_are_left_out_with_a_word(large: str) -> None:
    done = minimal(large, "--json")
    assert "are left out: add --matrices" in done.stderr
    short = json.loads(done.stdout)
    assert "matrix" not in short["reaction"]
    assert len(done.stdout) < 2e6
    assert "matrix" not in json.loads(minimal(PUMA, "--json", "--no-matrices").stdout)["dynamic"]


@pytest.mark.slow
def test_large_matrices_are_written_if_asked_for(large: str) -> None:
    done = minimal(large, "--json", "--matrices")
    assert done.stderr == ""
    document = json.loads(done.stdout)
    assert np.shape(document["reaction"]["matrix"]) == (len(document["reaction"]["names"]), 600)


@pytest.mark.slow
def test_it_imports_only_what_it_needs() -> None:
    """Most of the second that it takes would be imports that it has no use for."""
    words = ["-X", "importtime", "-m", "testbed.cli", "minimal", UR5]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True)
    names = (line.rpartition("|")[2].strip() for line in done.stderr.splitlines())
    loaded = {name.partition(".")[0] for name in names}
    assert "pinocchio" in loaded
    assert not loaded & {"scipy", "mujoco", "numba", "rerun", "matplotlib"}  # typer has pydantic
