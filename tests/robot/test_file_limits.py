"""Files that would hang, crash or deface: each is one printable line, at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ModelError
from testbed.robot.formats.mjcf_xml import check_files
from tests.helpers.robots import random_robot
from tests.helpers.work import counted_calls

MASS = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
BODY = f"<body><joint/>{MASS}</body>"
WORLD = "<mujoco>{}<worldbody>{}</worldbody></mujoco>"


def refusal(path: Path) -> str:
    """The line that refuses a file; found with little work."""
    with counted_calls() as calls, pytest.raises(ModelError) as caught:
        tb.load_tree(path)
    assert calls.count < 5_000_000
    said = str(caught.value)
    assert said.isprintable()
    assert len(said) < 1000
    assert path.name in said
    return said


HOLDING_THEMSELVES = {
    "model": {"a.xml": '<asset><model name="m" file="a.xml"/></asset>'},
    "unnamed model": {"a.xml": '<asset><model file="./a.xml"/></asset>'},
    "include": {"a.xml": '<include file="a.xml"/>'},
    "two models": {
        "a.xml": '<asset><model name="m" file="b.xml"/></asset>',
        "b.xml": '<asset><model name="m" file="a.xml"/></asset>',
    },
    "model by include": {
        "a.xml": '<include file="b.xml"/>',
        "b.xml": '<asset><model name="m" file="a.xml"/></asset>',
    },
    "in a folder": {
        "a.xml": '<asset><model file="sub/b.xml"/></asset>',
        "sub/b.xml": '<asset><model file="../a.xml"/></asset>',
    },
    "not the first": {
        "a.xml": '<asset><model file="b.xml"/></asset>',
        "b.xml": '<asset><model file="b.xml"/></asset>',
    },
}


@pytest.mark.parametrize("how", HOLDING_THEMSELVES)
def test_a_model_that_holds_itself_is_refused(how: str, tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    for name, head in HOLDING_THEMSELVES[how].items():
        (tmp_path / name).write_text(WORLD.format(head, BODY))
    assert "holds itself" in refusal(tmp_path / "a.xml")


def test_a_symbolic_link_does_not_hide_it(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(WORLD.format('<asset><model file="b.xml"/></asset>', BODY))
    (tmp_path / "b.xml").symlink_to("a.xml")
    assert "holds itself" in refusal(tmp_path / "a.xml")


def test_models_that_hold_ten_each_are_counted(tmp_path: Path) -> None:
    """Seven files of ten lines would become ten million bodies."""
    assets = "".join(f'<model name="m{i}" file="{{}}"/>' for i in range(10))
    attached = "".join(
        f'<frame><attach model="m{i}" body="b" prefix="p{i}"/></frame>' for i in range(10)
    )
    for k in range(7):
        text = WORLD.format(
            f"<asset>{assets.format(*[f'l{k + 1}.xml'] * 10)}</asset>",
            f'<body name="b">{attached}</body>',
        )
        (tmp_path / f"l{k}.xml").write_text(text)
    (tmp_path / "l7.xml").write_text(WORLD.format("", f'<body name="b"><joint/>{MASS}</body>'))
    assert "would become" in refusal(tmp_path / "l0.xml")
    assert tb.load_tree(tmp_path / "l6.xml").n == 10


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (f'<replicate count="1000000000">{BODY}</replicate>', "over 10^9 bodies"),
        (f'<replicate count="6000">{BODY}</replicate>', "6000 bodies"),
        ('<replicate count="100">' * 12 + BODY + "</replicate>" * 12, "over 10^24 bodies"),
        (
            f'<body name="b"><joint/>{MASS}<flexcomp name="f" count="1000 1000 1000"/></body>',
            "over 10^9 elements",
        ),
        (
            f'<body><joint/>{MASS}<composite type="cable" count="1000000 1 1"/></body>',
            "limits",
        ),
    ],
)
def test_copies_are_counted_before_they_are_made(inside: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(WORLD.format("", inside))
    assert said in refusal(tmp_path / "r.xml")


def test_what_is_replicated_in_earnest_is_read(tmp_path: Path) -> None:
    head = '<option gravity="0 0 -1"/>'
    arms = f'<replicate count="12" euler="0 0 30" sep="-">{BODY}</replicate>'
    (tmp_path / "r.xml").write_text(WORLD.format(head, arms))
    assert tb.load_tree(tmp_path / "r.xml").n == 12


LARGE = {
    "height field": (
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        "height field",
    ),
    "numeric": ('<custom><numeric name="n" size="500000000"/></custom>', "size"),
    "reserved": ('<size memory="900G" nuserdata="2000000000"/>', "nuserdata"),
}


@pytest.mark.parametrize("what", LARGE)
def test_large_arrays_are_refused(what: str, tmp_path: Path) -> None:
    head, said = LARGE[what]
    (tmp_path / "r.xml").write_text(WORLD.format(head, BODY))
    assert said in refusal(tmp_path / "r.xml")


@pytest.mark.parametrize(
    "head",
    [
        '<asset><texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>'
        '<material name="m" texture="t"/></asset>',
        '<size memory="900G"/>',
    ],
)
def test_what_only_a_viewer_would_hold_takes_no_room(head: str, tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(WORLD.format(head, BODY))
    assert tb.load_tree(tmp_path / "r.xml").n == 1


@pytest.mark.parametrize("form", ["xml", "urdf"])
def test_deep_nesting_is_refused(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"r.{form}"
    depth = 300_000
    inner = "<a>" * depth + "</a>" * depth
    path.write_text(f"<mujoco>{inner}</mujoco>" if form == "xml" else f"<robot>{inner}</robot>")
    assert "deep in each other" in refusal(path)


def chain(links: int, kind: str) -> str:
    """Links in a row."""
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        "</inertial>"
    )
    return (
        '<robot name="r"><link name="l0"/>'
        + "".join(
            f'<link name="l{k + 1}">{inertial}</link><joint name="j{k}" '
            f'type="{kind if k else "continuous"}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            "</joint>"
            for k in range(links)
        )
        + "</robot>"
    )


@pytest.mark.parametrize(("links", "kind"), [(9000, "fixed"), (9000, "continuous")])
@pytest.mark.slow
def test_endless_chains_are_refused(links: int, kind: str, tmp_path: Path) -> None:
    """Pinocchio's parser would run out of its stack."""
    (tmp_path / "r.urdf").write_text(chain(links, kind))
    assert "a chain of more than" in refusal(tmp_path / "r.urdf")


@pytest.mark.slow
def test_a_long_chain_of_fixed_links_is_read(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(chain(1400, "fixed"))
    tree = tb.load_tree(tmp_path / "r.urdf")
    assert tree.inertias[0].mass == pytest.approx(1400.0)


@pytest.mark.parametrize("form", ["xml", "urdf"])
@pytest.mark.slow
def test_too_many_joints_are_refused(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"r.{form}"
    bodies = "".join(f'<body name="b{k}"><joint name="k{k}"/>{MASS}</body>' for k in range(1200))
    path.write_text(chain(1200, "continuous") if form == "urdf" else WORLD.format("", bodies))
    assert "1200 joints that move; 1000 is the limit" in refusal(path)


@pytest.mark.parametrize("form", ["xml", "urdf"])
@pytest.mark.parametrize("joints", [150, 400])
@pytest.mark.slow
def test_work_grows_no_faster_than_the_number_of_joints(
    joints: int, form: str, tmp_path: Path
) -> None:
    robot = random_robot(np.random.default_rng(0), joints)
    path = tmp_path / f"r.{form}"
    path.write_text(robot.urdf() if form == "urdf" else robot.mjcf())
    tb.load_tree(path)  # what is imported once does not count
    with counted_calls() as calls:
        assert tb.load_tree(path).n == joints
    assert calls.count < 4000 * joints


@pytest.mark.slow
@pytest.mark.parametrize("form", ["xml", "urdf"])
def test_too_many_elements_are_refused(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"r.{form}"
    inside = "<a/>" * 200_001
    path.write_text(f"<mujoco>{inside}</mujoco>" if form == "xml" else f"<robot>{inside}</robot>")
    assert "more than 200000 elements" in refusal(path)


@pytest.mark.parametrize("what", ["link", "joint"])
def test_names_that_stand_twice_are_told(what: str, tmp_path: Path) -> None:
    old = {"link": '<link name="l2"', "joint": '<joint name="j2"'}[what]
    text = chain(3, "continuous").replace(old, old.replace("2", "1"))
    (tmp_path / "r.urdf").write_text(text)
    assert f"two {what}s have the name '{what[0]}1'" in refusal(tmp_path / "r.urdf")


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "r.urdf").open("wb") as file:
        file.write(b'<robot name="r">')
        file.truncate(2**27)
    assert "128 MiB" in refusal(tmp_path / "r.urdf")


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_encodings_that_mujoco_does_not_read_are_refused(encoding: str, tmp_path: Path) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + WORLD.format(
        "", f'<body name="b\u00e9"><joint name="\u00e9"/>{MASS}</body>'
    )
    (tmp_path / "r.xml").write_bytes(text.encode(encoding))
    assert "UTF-8" in refusal(tmp_path / "r.xml")


def test_urdfs_of_any_encoding_are_read(tmp_path: Path) -> None:
    text = '<?xml version="1.0" encoding="{}"?>' + chain(2, "continuous").replace("j0", "\u00e9")
    for encoding in ("latin-1", "utf-16", "utf-8"):
        (tmp_path / "r.urdf").write_bytes(text.format(encoding).encode(encoding))
        assert tb.load_tree(tmp_path / "r.urdf").names == ("\u00e9", "j1")


EXTREME = ["1e300", "1e400", "-1e13", "9" * 400]


@pytest.mark.parametrize("number", EXTREME)
@pytest.mark.parametrize(
    "body",
    [
        f'<body pos="0 0 {{}}"><joint/>{MASS}</body>',
        f'<body><joint pos="0 {{}} 0"/>{MASS}</body>',
        f'<body><joint axis="{{0}} 0 0" pos="{{0}} 0 0"/>{MASS}</body>',
        '<body><joint/><inertial mass="1" pos="{} 0 0" diaginertia="1 1 1"/></body>',
        '<body><joint/><inertial mass="{}" pos="0 0 0" diaginertia="1 1 1"/></body>',
        '<body><joint/><inertial mass="1" pos="0 0 0" diaginertia="{0} {0} {0}"/></body>',
    ],
)
def test_extreme_numbers_of_mjcf_are_refused(number: str, body: str, tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(WORLD.format("", body.format(number)))
    refusal(tmp_path / "r.xml")


@pytest.mark.parametrize("number", EXTREME)
@pytest.mark.parametrize("place", ['<origin xyz="0 0 {}"/>', '<axis xyz="0 {} 1"/>'])
def test_extreme_numbers_of_urdf_are_refused(number: str, place: str, tmp_path: Path) -> None:
    text = chain(2, "continuous").replace("</joint>", f"{place.format(number)}</joint>", 1)
    (tmp_path / "r.urdf").write_text(text)
    assert "'j0'" in refusal(tmp_path / "r.urdf")


# names

NAMES = {
    "C1": "a\u009bb",
    "next line": "a\u0085b",
    "override": "a\u202eb",
    "isolate": "\u2066a",
    "mark": "a\u200f",
    "byte order": "a\ufeffb",
    "line separator": "a\u2028b",
    "line break": "a&#10;b",
    "tabulator": "a&#9;b",
    "endless": "a" * 201,
}
PLACES = {
    "joint.urdf": '<robot name="r">{}<link name="b"/><link name="l"/>'
    '<joint name="@" type="continuous"><parent link="b"/><child link="l"/></joint></robot>',
    "link.urdf": '<robot name="r"><link name="b"/><link name="@"/><joint name="j" '
    'type="continuous"><parent link="b"/><child link="@"/></joint></robot>',
    "robot.urdf": '<robot name="@"><link name="b"/><link name="l"/><joint name="j" '
    'type="continuous"><parent link="b"/><child link="l"/></joint></robot>',
    "kind.urdf": '<robot name="r"><link name="b"/><link name="l"/><joint name="j" type="@">'
    '<parent link="b"/><child link="l"/></joint></robot>',
    "joint.xml": WORLD.format("", f'<body name="b"><joint name="@"/>{MASS}</body>'),
    "body.xml": WORLD.format("", f'<body name="@"><joint name="j"/>{MASS}</body>'),
    "model.xml": WORLD.format("", BODY).replace("<mujoco>", '<mujoco model="@">'),
    "mesh.xml": WORLD.format('<asset><mesh file="@"/></asset>', BODY),
}


@pytest.mark.parametrize("what", NAMES)
@pytest.mark.parametrize("place", PLACES)
def test_names_are_plain_text(place: str, what: str, tmp_path: Path) -> None:
    path = tmp_path / place
    path.write_text(PLACES[place].replace("@", NAMES[what]), encoding="utf-8")
    assert any(word in refusal(path) for word in ("control characters", "201 characters"))


@pytest.mark.parametrize("name", ["Gelenk-Ä/1", "关节 1", "a" * 200, "j.1[0]"])
def test_names_of_all_languages_are_kept(name: str, tmp_path: Path) -> None:
    for place in ("joint.urdf", "joint.xml"):
        text = PLACES[place].replace("{}", "").replace("@", name)
        (tmp_path / place).write_text(text, encoding="utf-8")
        assert tb.load_tree(tmp_path / place).names == (name,)


@pytest.mark.parametrize(("times", "refused"), [(40, False), (60, True)])
def test_a_model_that_is_attached_often_counts_as_often(
    times: int, refused: bool, tmp_path: Path
) -> None:
    """A hundred bodies each time: five thousand are the limit."""
    inside = f'<body name="b"><joint/>{MASS}' + BODY * 99 + "</body>"
    (tmp_path / "part.xml").write_text(WORLD.format("", inside))
    attached = "".join(
        f'<frame><attach model="m" body="b" prefix="p{i}"/></frame>' for i in range(times)
    )
    asset = '<asset><model name="m" file="part.xml"/></asset>'
    (tmp_path / "all.xml").write_text(WORLD.format(asset, f'<body name="a">{attached}</body>'))
    if refused:
        with pytest.raises(ModelError, match="would become"):
            check_files(tmp_path / "all.xml")
    else:
        check_files(tmp_path / "all.xml")


@pytest.mark.parametrize(("depth", "fine"), [(7, True), (9, False)])
def test_files_hold_each_other_so_deep_and_no_deeper(
    depth: int, fine: bool, tmp_path: Path
) -> None:
    body = (
        '<body name="b"><inertial mass="1" pos="0 0 0.1" diaginertia="1 1 1"/>'
        '<joint name="j" axis="0 1 0"/></body>'
    )
    for k in range(depth):
        (tmp_path / f"f{k}.xml").write_text(f'<mujoco><include file="f{k + 1}.xml"/></mujoco>')
    (tmp_path / f"f{depth}.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    if fine:
        assert tb.load_tree(tmp_path / "f0.xml").names == ("j",)
        return
    with pytest.raises(ModelError, match="more than 8 files hold each other"):
        tb.load_tree(tmp_path / "f0.xml")
