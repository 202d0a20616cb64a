"""What terminal, page and viewer show of other robots than the PUMA is what somebody approved.

Arms that turn, slide, or both, a tree with shapes, one with gears, and one on a base that moves.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

import testbed as tb
from testbed.experiment.run import Run, assemble_run
from testbed.experiment.unseen import validated
from testbed.recordings.measured_base import with_base_joints
from testbed.reporting.html import write_report
from testbed.reporting.terminal import print_estimates
from testbed.robot.model_file import ModelFile
from testbed.viewer.log import write_rrd
from testbed.viewer.scene import scene_of
from tests.helpers.approved import hold, tags, timeless
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN, REAL
from tests.helpers.riding import riding
from tests.helpers.viewer import content

pytestmark = pytest.mark.slow

FINGERS = dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"))
FILES = {
    "ur5": ModelFile(GOLDEN / "robots/ur5.urdf"),
    "gantry": ModelFile(GOLDEN / "robots/gantry_ppp_rrr.urdf"),
    "stanford": ModelFile(GOLDEN / "robots/stanford.urdf"),
    "two_trunks": ModelFile(GOLDEN / "robots/two_trunks.urdf"),
    "panda": ModelFile(REAL / "panda_description/urdf/panda.urdf", lock=FINGERS),
}
SETTINGS = {
    "ur5": tb.Settings(terms="auto"),
    "gantry": tb.Settings(nuisances=("bias", "matrix"), known={"mass": (30.0, 0.01)}),
    "stanford": tb.Settings(zeros=True, drives="given"),
}
ROBOTS = (*FILES, "riding")


@cache
def run_of(name: str) -> Run:
    """With what its estimates leave of a second recording."""
    if name == "riding":
        tree, recording = riding(3)
        return assemble_run(tree, with_base_joints(recording), name=name)
    tree = FILES[name].tree()
    first, second = (measured(tree, seed, duration=8.0) for seed in (1, 2))
    settings = SETTINGS.get(name)
    run = assemble_run(tree, first, name=name, settings=settings, model=FILES[name])
    return validated(run, second)


def told(text: str) -> str:
    return timeless(re.sub(r"/\S*?/(golden|robots)/", "", text))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_page_is_as_approved(name: str, tmp_path: Path) -> None:
    run = run_of(name)
    other = None
    if name != "riding":
        other = measured(FILES[name].tree(), 2, duration=8.0)
    write_report(run, tmp_path / "page.html", other)
    hold(f"robot_{name}.html.txt", told(tags((tmp_path / "page.html").read_text())))


@pytest.mark.parametrize("name", ROBOTS)
def test_what_the_viewer_shows_is_as_approved(name: str, tmp_path: Path) -> None:
    write_rrd([scene_of(run_of(name))], tmp_path / "view.rrd")
    hold(f"robot_{name}.rrd.txt", told(content(tmp_path / "view.rrd")))


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("width", [60, 100])
def test_what_the_terminal_shows_is_as_approved(
    name: str, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    run = run_of(name)
    print_estimates(list(run.estimates.values()), run.warnings)
    hold(f"robot_{name}_{width}.txt", told("\n".join(capsys.readouterr())))
