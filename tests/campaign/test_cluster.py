"""Dask: local workers and a cluster by address give the same bits; nothing is lost by a death."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.campaign import Scene, campaign_of, cluster, kills
from testbed.campaign.bundle import Bundle, Outcome
from testbed.campaign.campaign import Campaign
from testbed.campaign.cluster import Tls, Work, local_workers, workers_at
from testbed.campaign.conduct import InThisProcess, conduct
from testbed.errors import ExperimentError
from tests.helpers.campaigns import NOISES, campaign_file, made_up
from tests.helpers.command import CLI, command_line
from tests.helpers.paths import ROOT

pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("default")  # Dask's own, while it shuts down


def table(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes()


def deadly(bundle: Bundle) -> tuple[list[Outcome], float]:
    """Kills its process whenever a certain run is in the bundle."""
    if any("seed=3" in words for _, words in bundle.runs):
        os.kill(os.getpid(), signal.SIGKILL)
    return made_up(bundle)


@pytest.mark.slow
def test_local_workers_and_a_cluster_by_address_give_the_same_bits(tmp_path: Path) -> None:
    campaign = Campaign.load(campaign_file(tmp_path, 4, NOISES))
    conduct(campaign, tmp_path / "alone", InThisProcess())
    with local_workers(2) as engine:
        conduct(campaign, tmp_path / "local", engine)
    file = tmp_path / "quick.toml"
    with cluster(2) as (address, _):
        done = command_line(
            *("campaign", str(file), "--out", "there", "--scheduler", address), cwd=tmp_path
        )
    assert done.returncode == 0, done.stderr
    assert "8 runs with a result, 0 without" in done.stdout
    assert table(tmp_path / "alone") == table(tmp_path / "local") == table(tmp_path / "there")


@pytest.mark.slow
def test_a_run_that_kills_its_workers_is_recorded_and_the_others_go_on(tmp_path: Path) -> None:
    campaign = Campaign.load(campaign_file(tmp_path, 5))
    with local_workers(1, deadly) as engine:
        folder = conduct(campaign, tmp_path / "r", engine)
    ((command, error),) = folder.failures()
    assert "workers died with it" in error
    assert "seed=3" in command
    assert sorted(folder.status.values()) == ["done"] * 4 + ["killed"]


@pytest.mark.slow
@pytest.mark.parametrize("who", ["worker", "scheduler", "command"])
def test_a_kill_at_a_random_moment_costs_nothing(who: str) -> None:
    """More of it: python -m benchmarks campaign."""
    assert kills(who, 1, 60, random.Random(who).randrange(1000))["same_table"] == 1


@pytest.mark.slow
def test_ctrl_c_ends_cleanly_and_the_same_command_goes_on(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, 400, words=["motion.duration=5.0"])
    words = [*CLI, "campaign", str(file), "--out", "r", "--workers", "1"]
    command = subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    new = tmp_path / "r/new"
    deadline = time.monotonic() + 120
    while not (new.is_dir() and any(new.glob("*.parquet"))) and time.monotonic() < deadline:
        time.sleep(0.1)
    command.send_signal(signal.SIGINT)
    _, said = command.communicate(timeout=120)
    assert command.returncode == 130
    assert said.endswith("testbed: interrupted\n")  # after lines of progress
    assert "Traceback" not in said
    assert not list(new.iterdir())
    done = command_line("campaign", "--summary", "r", cwd=tmp_path)
    assert done.returncode == 0
    assert " runs in 1 cell; none without a result." in done.stdout


def test_no_scheduler_no_dask_and_half_a_set_of_tls_files_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = str(campaign_file(tmp_path, 1))
    wrong = command_line("campaign", file, "--tls-ca", "x", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "go together" in wrong.stderr
    both = command_line("campaign", file, "--scheduler", "tcp://x", "--workers", "2", cwd=tmp_path)
    assert both.returncode == 2
    monkeypatch.setitem(sys.modules, "distributed", None)
    wanted = r"pip install '.\[cluster\]'"
    with pytest.raises(ExperimentError, match=wanted), local_workers(1):
        pass


@pytest.mark.slow
def test_an_encrypted_scheduler_takes_whom_it_knows_and_nobody_else(tmp_path: Path) -> None:
    tls = certificates(tmp_path)
    options = [
        *("--tls-ca-file", str(tls.authority), "--tls-cert", str(tls.certificate)),
        *("--tls-key", str(tls.key)),
    ]
    campaign = Campaign.load(campaign_of(tmp_path, 20))
    with cluster(1, "tls", options) as (address, _):
        with workers_at(address, tls, made_up) as engine:
            folder = conduct(campaign, tmp_path / "r", engine)
        assert len(folder.status) == 20
        strangers = replace(tls, certificate=tls.authority)
        refused = pytest.raises(ExperimentError, match="no scheduler answers")
        with refused, workers_at(address, strangers, made_up, "5s"):
            pass


def certificates(folder: Path) -> Tls:
    """An authority, and one pair of certificate and key that it has signed."""
    made = [folder / name for name in ("ca.pem", "own.pem", "own.key")]
    openssl = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"]
    subprocess.run(
        [*openssl, "-keyout", str(folder / "ca.key"), "-out", str(made[0]), "-subj", "/CN=ca"],
        check=True, capture_output=True,
    )  # fmt: skip
    signed = ["-CA", str(made[0]), "-CAkey", str(folder / "ca.key")]
    subprocess.run(
        [*openssl, "-keyout", str(made[2]), "-out", str(made[1]), "-subj", "/CN=own", *signed],
        check=True, capture_output=True,
    )  # fmt: skip
    return Tls(*made)


@pytest.mark.slow
def test_the_scene_of_a_kill_ends_well_undisturbed(tmp_path: Path) -> None:
    """What the kills are measured against."""
    scene = Scene(campaign_of(tmp_path, 30), tmp_path / "r", "1")
    assert scene.start().wait(120) == 0
    assert len(table(tmp_path / "r")) > 1000
    assert ROOT.is_dir()


def mistaken(bundle: Bundle) -> tuple[list[Outcome], float]:
    raise ValueError(f"{len(bundle.runs)} runs are no number")


def refused(bundle: Bundle) -> tuple[list[Outcome], float]:
    raise ExperimentError("the worker has other files")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "said"),
    [
        (mistaken, "^the workers cannot do it: ValueError: . runs are no number$"),
        (refused, "^the worker has other files$"),
    ],
)
def test_workers_that_cannot_do_it_at_all_end_a_campaign(
    work: Work, said: str, tmp_path: Path
) -> None:
    campaign = Campaign.load(campaign_file(tmp_path, 3))
    with (
        local_workers(1, work) as engine,
        pytest.raises(ExperimentError, match=said),
    ):
        conduct(campaign, tmp_path / "r", engine)
