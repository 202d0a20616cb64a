"""A motion before any run, in the viewer: its path, what it leaves of its limits."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from testbed.errors import ExperimentError
from testbed.excitation.collision_model import Obstacle
from testbed.experiment.motions import CheckedMotion, checked_motion, obstacles_of
from testbed.robot.visuals.appearance import load_appearance
from testbed.viewer import show
from testbed.viewer.motion_log import write_motion_rrd
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS
from tests.helpers.viewer import columns, entities, headless_viewer, settled, words

pytestmark = pytest.mark.slow

MOTION = ROOT / "experiments/motions/table6.toml"


@pytest.fixture(scope="module")
def checked() -> CheckedMotion:
    return checked_motion(MOTION)


@pytest.fixture(scope="module")
def shown(checked: CheckedMotion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motion") / "motion.rrd"
    look = load_appearance(checked.rules.tree)
    boxes = (Obstacle(np.array([1.0, 0, 0.5]), np.array([0.1, 0.2, 0.5])),)
    write_motion_rrd(path, checked.motion, checked.rules, checked.proof, look, boxes)
    return path


def test_bodies_are_where_pinocchio_puts_them(checked: CheckedMotion, shown: Path) -> None:
    model = pin.buildModelFromUrdf(str(ROOT / "models/puma562.urdf"))
    data = model.createData()
    places = columns(shown, "/world/robot/3", "Transform3D:translation").reshape(-1, 3)
    q = checked.motion.at(np.linspace(0, checked.motion.period, len(places))).q
    order = [list(model.names)[1:].index(name) for name in checked.rules.tree.names]
    for k in range(0, len(places), 37):
        values = np.empty(model.nq)
        values[order] = q[k]
        pin.forwardKinematics(model, data, values)
        joint = model.getJointId(checked.rules.tree.names[2])
        np.testing.assert_allclose(places[k], data.oMi[joint].translation, atol=1e-6)


def test_what_is_left_is_no_less_than_proven(checked: CheckedMotion, shown: Path) -> None:
    left = columns(shown, "/left/1", "Scalars:scalars")
    proven = [m.left for m in checked.proof.margins if m.label.startswith("velocity")]
    assert 100 * min(proven) <= left.min() <= 100 * min(proven) + 1.0
    assert {"/world/obstacles", "/world/path/3", "/notes", "/position/waist"} <= entities(shown)
    (said,) = words(shown, "/notes", "TextDocument:text")
    assert "Proven at every moment" in said
    assert "velocity" in said


def test_boxes_of_the_cell_are_in_its_settings() -> None:
    asked = "excitation.obstacle=[{centre=[1.5,0,0.5],size=[0.2,0.2,1.0]}]"
    (box,) = obstacles_of(checked_motion(MOTION, [asked]).experiment)
    np.testing.assert_array_equal(box.half, [0.1, 0.1, 0.5])


def test_the_viewer_has_nothing_to_complain_about(shown: Path, tmp_path: Path) -> None:
    with headless_viewer(tmp_path) as (viewer, _):
        viewer.open(str(shown))
        settled(viewer)
        viewer.set_time("time", duration=2.0, play_state="paused")
        time.sleep(2)
        viewer.save_screenshot(str(tmp_path / "shot.png"))
        assert [view.reports for view in settled(viewer) if view.reports] == []
        assert (tmp_path / "shot.png").stat().st_size > 50_000


def test_a_robot_with_more_joints_is_told_how_to_hold_them(tmp_path: Path) -> None:
    text = MOTION.read_text().replace("../../models/puma562.xml", str(MODELS["puma"]))
    first = text.index('[joint."elbow"]')
    (tmp_path / "other.toml").write_text(text[:first] + text[text.index("[limits]") :])
    with pytest.raises(ExperimentError, match="which the motion leaves out, by --set robot.lock"):
        checked_motion(tmp_path / "other.toml")


def test_without_a_place_it_is_written_beside_the_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = MOTION.read_text().replace("../../models", str(ROOT / "models"))
    (tmp_path / "swing.toml").write_text(text)
    monkeypatch.setattr(show, "has_screen", lambda: False)
    done = command_line("view", "swing.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert "no screen" in done.stderr
    assert "--save swing.rrd" in done.stderr
    assert not (tmp_path / "swing.rrd").exists()
