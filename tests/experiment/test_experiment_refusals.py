"""What an experiment, its motion file or its run folder cannot say is refused in words about it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExperimentError
from testbed.excitation.fourier import Fourier
from testbed.experiment.evaluate import robot_of
from testbed.experiment.motion_file import MotionFile, read_motion
from testbed.experiment.run_folder import read_run, write_recorded, write_run
from tests.helpers.ideal import ideal
from tests.helpers.runs import MODELS, noisy, robot, run_of

PUMA = MODELS["puma"]


def experiment(folder: Path, *settings: str, before: str = "") -> tb.Experiment:
    """With its own copy of the model."""
    shutil.copy(PUMA, folder / PUMA.name)
    (folder / "made.toml").write_text(f'name = "made"\nmodel = "{PUMA.name}"\n{before}')
    return tb.Experiment.load(folder / "made.toml", settings)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (('model="a\\u0000b"',), "model or motion.file is not a file name"),
        (('motion.file="a\\u0000b"',), "model or motion.file is not a file name"),
        (("expect={internal_rms={}}",), "a claim needs at_most or at_least"),
    ],
)
def test_settings_that_say_nothing_sensible_are_refused(
    settings: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    with pytest.raises(ExperimentError, match=said) as error:
        experiment(tmp_path, *settings)
    assert "\n" not in str(error.value)


def test_an_experiment_has_a_bedplate(tmp_path: Path) -> None:
    made = experiment(tmp_path, 'robot.base="measured"')
    with pytest.raises(ExperimentError, match="is for recordings: experiments have a bedplate"):
        robot_of(made)


def test_tables_speak_of_joints_that_there_are(tmp_path: Path) -> None:
    made = experiment(tmp_path, "motion.max_velocity={ellbow=1}")
    with pytest.raises(ExperimentError, match=r"speaks of joint 'ellbow', the model has waist, "):
        robot_of(made)


MOTION = """
model = "{model}"
fundamental = 0.5
[joint.waist]
offset = 0.1
sine = {sine}
cosine = [0.0, 0.2]
"""


@pytest.mark.parametrize(
    ("model", "sine", "said"),
    [
        ("puma.xml", "[0.1]", r"sines and cosines, equally many, found \[1, 2\]"),
        ("a\\u0000", "[0.1, 0.2]", "model is not a file name"),
    ],
)
def test_motion_files_that_fit_nothing_are_refused(
    model: str, sine: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "motion.toml").write_text(MOTION.format(model=model, sine=sine))
    with pytest.raises(ExperimentError, match=said):
        read_motion(tmp_path / "motion.toml")


def test_a_motion_file_is_read_joint_by_joint(tmp_path: Path) -> None:
    (tmp_path / "motion.toml").write_text(MOTION.format(model="puma.xml", sine="[0.1, -0.3]"))
    found = read_motion(tmp_path / "motion.toml")
    assert found.model == tmp_path / "puma.xml"
    wanted = Fourier(0.5, np.array([0.1]), np.array([[0.1, -0.3]]), np.array([[0.0, 0.2]]))
    times = np.linspace(0, 2, 9)
    np.testing.assert_allclose(found.motion.at(times).q, wanted.at(times).q, atol=1e-15)


@pytest.mark.parametrize(
    ("joints", "hint"),
    [
        (("waist", "shoulder"), True),
        (("waist", "shoulder", "wrist"), False),
        (("waist", "shoulder", "elbow", "wrist"), False),
    ],
)
def test_a_motion_of_other_joints_is_refused(
    joints: tuple[str, ...], hint: bool, tmp_path: Path
) -> None:
    """With the way on where the robot has more of them than the motion."""
    tree = robot("puma")
    still = Fourier.of(0.1, np.zeros((len(joints), 5)))
    motion = MotionFile(tmp_path / "m.toml", PUMA, still, joints)
    with pytest.raises(ExperimentError, match="moves waist, shoulder.*the robot has") as told:
        motion.motion_for(tree)
    assert ("robot.lock.JOINT=POSITION" in str(told.value)) == hint


def test_a_run_of_no_experiment_has_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match="run 'made' is of no experiment"):
        write_run(run_of(robot("gantry")), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_folder_holds_its_motion_and_its_model(tmp_path: Path) -> None:
    """Both as copies; without the model, or with another one, it is read no more."""
    sines = "[0.1, 0.2]"
    joints = "".join(
        f"[joint.{name}]\noffset = 0.1\nsine = {sines}\ncosine = {sines}\n"
        for name in robot("puma").names
    )
    (tmp_path / "slow.toml").write_text(f'model = "{PUMA.name}"\nfundamental = 0.1\n{joints}')
    made = experiment(tmp_path, 'motion.file="slow.toml"')
    recording = noisy(ideal(robot("puma")))
    write_recorded(made, recording, tmp_path / "run")
    (tmp_path / "slow.toml").unlink()
    again = tb.Experiment.load(tmp_path / "run/experiment.toml")
    assert Path(again.motion.file).parent == tmp_path / "run"
    assert read_motion(Path(again.motion.file)).motion.fundamental == 0.1
    with pytest.raises(ExperimentError, match="is not the model that was simulated; run it again"):
        read_run(tmp_path / "run")
    Path(again.model).unlink()
    with pytest.raises(ExperimentError, match="model file '.*' is not there any more"):
        read_run(tmp_path / "run")


def test_a_key_without_its_table_is_told_with_it() -> None:
    said = r"unknown key 'duration'; did you mean motion\.duration\?"
    with pytest.raises(ExperimentError, match=said):
        tb.Experiment.of_model(PUMA, ["duration=3"])
    with pytest.raises(ExperimentError, match="'nothing'.*known"):
        tb.Experiment.of_model(PUMA, ["nothing=3"])
