"""Options of commands about recordings: what each sets, and which of two counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.cli.reading import Reading
from tests.helpers.runs import MODELS

URDF = """<robot name="r">
  <link name="base"/>
  <link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <joint name="leads" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="follows" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="leads"/></joint>
</robot>
"""


def test_an_option_counts_before_a_setting() -> None:
    held = Reading(settings=["robot.lock.waist=0.25"], lock=["waist=0.5"]).model_file(
        MODELS["puma"]
    )
    assert dict(held.lock) == {"waist": 0.5}
    both = Reading(settings=["robot.lock.waist=0.25"], lock=["elbow"]).model_file(MODELS["puma"])
    assert dict(both.lock) == {"waist": 0.25, "elbow": None}


def test_a_joint_that_follows_is_held_where_it_is_told_to_be(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(URDF)
    for settings, lock_mimic in (((), True), (["robot.lock_mimic=true"], False)):
        plain = Reading(settings=settings, lock_mimic=lock_mimic)
        assert dict(plain.model_file(path).lock) == {"follows": None}
        placed = Reading(settings=settings, lock_mimic=lock_mimic, lock=["follows=0.5"])
        assert dict(placed.model_file(path).lock) == {"follows": 0.5}
    assert not Reading(settings=["robot.lock_mimic=false"]).model_file(path).lock


@pytest.mark.parametrize("how", ["option", "setting", "base", "neither"])
def test_a_floating_root_is_welded_where_it_is_said_or_its_base_is_measured(how: str) -> None:
    said = {
        "option": Reading(weld_root=True),
        "setting": Reading(weld_root=True, settings=["identification.zeros=true"]),
        "base": Reading(settings=['robot.base="measured"']),
        "neither": Reading(settings=["identification.zeros=true"]),
    }[how]
    assert said.model_file(MODELS["puma"]).weld_root == (how != "neither")


@pytest.mark.parametrize(
    ("terms", "expected"),
    [("auto", "auto"), ("coulomb", ("coulomb",)), ("coulomb,viscous", ("coulomb", "viscous"))],
)
def test_terms_are_auto_or_a_list(terms: str, expected: object) -> None:
    found = Reading(terms=terms, zeros=True).tables().identification
    assert (found.terms, found.zeros) == (expected, True)
    before = Reading(settings=['identification.terms=["rotor"]'], terms=terms).tables()
    assert before.identification.terms == expected
