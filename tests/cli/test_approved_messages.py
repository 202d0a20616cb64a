"""What is said to wrong command lines: one line, exit code 2, in words that somebody approved."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import testbed as tb
from tests.helpers.approved import hold
from tests.helpers.command import command_line
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.runs import without

pytestmark = pytest.mark.slow

PUMA, ROBOT = "puma562.xml", ("--model", "puma562.xml")
SETS = ("motion.duration=4", "simulation.step=1e-3", "motion.candidates=2")
SHORT = tuple(word for each in SETS for word in ("--set", each))


def run(*settings: str) -> tuple[str, ...]:
    """An experiment with settings."""
    return ("run", "table.toml", *SHORT, *(w for each in settings for w in ("--set", each)))


LINK = '<link name="{}"><inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="{}" ixy="0" \
ixz="0" iyz="0"/></inertial></link>'
TURN = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="{}"/></joint>'


def urdf(*parts: str) -> str:
    """A robot of two links and what is said besides."""
    return f'<robot name="a">{LINK.format("b", 1, 1)}{"".join(parts)}</robot>'


GOOD = LINK.format("c", 1, 1)
HINGE = TURN.format("j", "continuous", "b", "c", "0 0 1")
BROKEN = {
    "empty.urdf": "",
    "cut.urdf": urdf(GOOD)[:90],
    "no_robot.urdf": "<mujoco/>",
    "no_joint.urdf": urdf(GOOD),
    "no_parent.urdf": urdf(GOOD, TURN.format("j", "revolute", "x", "c", "0 0 1")),
    "no_type.urdf": urdf(GOOD, TURN.format("j", "hinge", "b", "c", "0 0 1")),
    "floating.urdf": urdf(GOOD, TURN.format("j", "floating", "b", "c", "0 0 1")),
    "no_axis.urdf": urdf(GOOD, TURN.format("j", "continuous", "b", "c", "0 0 0")),
    "two_axes.urdf": urdf(GOOD, TURN.format("j", "continuous", "b", "c", "0 0")),
    "twice.urdf": urdf(GOOD, GOOD, HINGE),
    "negative.urdf": urdf(
        LINK.format("c", -1, 1), HINGE
    ),
    "word.urdf": urdf(LINK.format("c", "x", 1), HINGE),
    "typo.urdf": urdf(GOOD.replace("mass value", "mass valeu"), HINGE),
    "other.urdf": urdf(GOOD.replace("mass value", "mass q"), HINGE),
    "no_child.urdf": urdf(GOOD, '<joint name="j" type="fixed"><parent link="b"/></joint>'),
    "no_name.urdf": urdf(GOOD, "<joint/>"),
    "low.urdf": urdf(
        GOOD,
        TURN.format("j", "prismatic", "b", "c", "1 0 0").replace(
            "</joint>", '<limit lower="1" upper="-1" effort="1" velocity="1"/></joint>'
        ),
    ),
    "circle.urdf": urdf(
        GOOD, HINGE,
        TURN.format("k", "continuous", "c", "b", "0 0 1"),
    ),
    "empty.xml": "<mujoco/>",
    "no_model.xml": "<robot/>",
    "ball.xml": '<mujoco><worldbody><body name="a"><joint type="ball"/><geom size="1"/></body>'
    "</worldbody></mujoco>",
    "unknown.xml": '<mujoco><worldbody><body nome="a"/></worldbody></mujoco>',
    "gone.xml": '<mujoco><include file="none.xml"/></mujoco>',
}  # fmt: skip
"""Model files that are none, by name."""

WRONG: dict[str, list[tuple[str, ...]]] = {
    "files": [
        ("run", "none.toml"), ("run", PUMA), ("run", "one.parquet"), ("run", "empty.toml"),
        ("minimal", "none.xml"), ("minimal", "table.toml"), ("minimal", "one.parquet"),
        ("identify", "none.parquet", *ROBOT), ("identify", PUMA, *ROBOT), ("report", "none"),
        ("identify", "one.parquet", "--model", "ur5.urdf"), ("view", "none"),
        ("report", "table.toml"), ("report", "one.parquet"), ("campaign", "table.toml"),
        ("campaign", "--summary", "none"), ("compare", "table.toml"), ("import", "none.toml"),
        ("import", "table.toml", "--out", "x.parquet"),
        ("new", "none.urdf"), ("new",), ("validate", "one.parquet", "none.json"),
        ("validate", "one.parquet", "table.toml"), ("payload", "one.parquet", "none", *ROBOT),
        ("calibrate", "none.parquet", *ROBOT, "--known", "mass=20"), ("simulate", "table.toml"),
        ("simulate", "table.toml", "--out", "x.txt"), ("excite", "none.xml"), ("view", PUMA),
        *(("minimal", name) for name in BROKEN),
    ],
    "keys": [
        run("motion.length=3"), run("motion=3"), run("seed=x"), run("seed=-1"), run("a.b.c=1"),
        run("motion.duration=0"), run("motion.duration=nan"), run("motion.duration=1e9"),
        run("simulation.step=1"), run("simulation.step=0"), run("simulation.step=1e-9"),
        run("measurement.rate=1e6"), run("measurement.rate=0.1"), run("motion.candidates=0"),
        run("measurement.fault=[{kind='plate'}]"), run("measurement.fault=[{kind=3}]"),
        run("measurement.fault=[{kind='plate_delay',late=1}]"),
        run("measurement.fault=[{kind='plate_bias',force=[1,2]}]"),
        run("simulation.effect=[{kind='wind'}]"),
        run("simulation.effect=[{kind='payload',mass=-1}]"),
        run("simulation.effect=[{kind='payload',joint='hip'}]"),
        run("identification.cutoff=-1"), run("identification.cutoff=1e5"),
        run("identification.terms=['slip']"), run("identification.nuisances=['wind']"),
        run("identification.zeros=['mb9x']"), run("identification.known={mass='x'}"),
        run("identification.known={weight=3}"), run("identification.span=[3,1]"),
        run("identification.drives='some'"), run("identification.engine='slide rule'"),
        run("robot.lock.hip=0"), run("robot.lock.elbow=99"), run("robot.joint.hip.coulomb=1"),
        run("robot.joint.elbow.coulomb=-1"), run("robot.weld_root=true"), run("gravity=[0,0]"),
        run("expect.speed.at_most=1"), run("expect.external_max_z.at_most='x'"),
        run("motion.file='none.toml'"), run("model='x'"),
        run("motion.harmonics=0"), run("motion.max_velocity={elbow=1e-9}"),
        run("consistent.metric=3"),
    ],
    "options": [
        ("minimal", PUMA, "--zero", "mb9x"), ("minimal", PUMA, "--terms", "slip"),
        ("minimal", PUMA, "--gravity", "1,2"), ("minimal", PUMA, "--gravity", "a,b,c"),
        ("minimal", PUMA, "--lock", "hip"), ("minimal", PUMA, "--lock", "elbow=x"),
        ("minimal", PUMA, "--lock", "elbow=50"), ("minimal", PUMA, "--speed"),
        ("equations", PUMA, "--max-terms", "5"), ("equations", PUMA, "--language", "fortran"),
        ("equations", PUMA, "--what", "power"), ("equations", PUMA, "--form", "short"),
        ("equations", PUMA, "--against", "table.toml"),
        ("equations", PUMA, "--against", "map.toml", "--out", "y"),
        ("equations", PUMA, "--against", "map.toml", "--what", "mass-matrix"),
        ("equations", PUMA, "--against", "map.toml", "--json"),
        ("identify", "one.parquet", *ROBOT, "--in-place"),
        ("equations", PUMA, "--max-terms", "0"),
        ("identify", "one.parquet", *ROBOT, "--terms", "slip"),
        ("identify", "one.parquet", *ROBOT, "--method", "magic"),
        ("identify", "one.parquet", *ROBOT, "--threads", "0"),
        ("identify", "one.parquet", *ROBOT, "--consistent", "--write", "x.urdf"),
        ("identify", "one.parquet", *ROBOT, "--consistent", "--write", PUMA),
        ("identify", "one.parquet", *ROBOT, "--plate", "table.toml"),
        ("identify", "one.parquet", *ROBOT, "--set", "motion.duration=3"),
        ("identify", "one.parquet", "one.parquet", *ROBOT), ("identify", "one.parquet"),
        ("payload", "one.parquet", "no_torque.parquet", *ROBOT, "--joint", "hip"),
        ("payload", "one.parquet", "no_torque.parquet", *ROBOT, "--at-rest"),
        ("identify", "one.parquet", *ROBOT, "--set", "identification.span=[50,60]"),
        ("calibrate", "one.parquet", *ROBOT, "--known", "mass"),
        ("calibrate", "one.parquet", *ROBOT, "--known", "mass=x"),
        ("calibrate", "one.parquet", *ROBOT, "--known", "gain/Fq=1"),
        ("calibrate", "one.parquet", *ROBOT, "--known", "mass=20"),
        ("calibrate", "one.parquet", *ROBOT, "--known", "mass=20+--1"),
        ("calibrate", "one.parquet", *ROBOT), ("drives", "no_torque.parquet", *ROBOT),
        ("drives", "no_wrench.parquet", *ROBOT),
        ("identify", "no_wrench.parquet", *ROBOT, "--method", "external"),
        ("identify", "no_torque.parquet", *ROBOT, "--method", "internal"),
        ("excite", PUMA, "--trajectory", "t.txt"), ("excite", PUMA, "--rate", "0"),
        ("excite", PUMA, "--check", "--page", "x.html", "--trajectory", "t.csv"),
        ("excite", PUMA, "--check"), ("excite", PUMA, "--prior", "table.toml"),
        ("excite", PUMA, "--out", "m.txt"), ("excite", PUMA, "--set", "excitation.starts=0"),
        ("excite", PUMA, "--set", "excitation.plate_range=[1,1,1,1,1,1]"),
        ("campaign", "many.toml"), ("campaign", "many.toml", "--workers", "-1"),
        ("campaign", "many.toml", "--limit", "0"), ("campaign", "many.toml", "--tls-ca", "x"),
        ("faults", "plate_wind"), ("effects", "wind"), ("fly",), ("run", "--live"), ("warmup", "x"),
        ("report", "one.parquet", *ROBOT, "--out", "x.pdf"),
        ("view", "one.parquet", *ROBOT, "--save", "x.png"),
        ("report", "one.parquet", "--zeros"),
        ("report", "none", "--consistent"), ("excite", PUMA, "--page", "x.pdf"),
        ("import", "map.toml", "--align", "--out", "x.parquet"), ("doctor", "now"),
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot, another, a recording, one without torques, one without a plate."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(ROOT / "models/puma562.xml", folder / PUMA)
    shutil.copy(GOLDEN / "robots/ur5.urdf", folder / "ur5.urdf")
    text = (ROOT / "experiments/table6.toml").read_text()
    (folder / "table.toml").write_text(text.replace("../models/", ""))
    (folder / "empty.toml").write_text("")
    for name, text in BROKEN.items():
        (folder / name).write_text(text)
    (folder / "map.toml").write_text('rate = 100\njoints = ["a"]\n')
    (folder / "many.toml").write_text('name = "many"\nexperiment = "table.toml"\n[[factor]]\n')
    found = tb.simulate(tb.Experiment.load(folder / "table.toml", SETS))
    found.save(folder / "one.parquet")
    for signal in ("torque", "wrench"):
        without(found, signal).save(folder / f"no_{signal}.parquet")
    return folder


@pytest.mark.parametrize("about", WRONG)
def test_wrong_command_lines_are_answered_as_approved(
    place: Path, about: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    lines = []
    for words in WRONG[about]:
        before = sorted(path.name for path in place.rglob("*"))
        done = command_line(*words, cwd=place)
        shown = " ".join(word for word in words if word not in SHORT)
        said = (done.stdout + done.stderr).replace(str(place), "").strip()
        said = re.sub(r"table6-[0-9a-f]{8}", "table6-HASH", said)
        lines.append(f"$ testbed {shown}\n{said}\n")
        assert done.returncode == 2, said
        assert len(said.splitlines()) == 1, said
        if "is kept in" not in said:
            assert sorted(path.name for path in place.rglob("*")) == before, said
    hold(f"wrong_{about}.txt", "\n".join(lines))
