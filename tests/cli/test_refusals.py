"""What is wrong with a command line is said in one line that names it, and nothing is left behind.

Tables of wrong words, of model files that are none, and of words and files of any other kind.
"""

from __future__ import annotations

import os
import shlex
import shutil
from pathlib import Path

import pytest

from testbed.core.base.file_kinds import USAGE, kind_of
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.helpers.refusals import is_message

pytestmark = pytest.mark.slow

LINK = '<link name="{}"><inertial><mass {}/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" \
iyz="0"/></inertial></link>'
TURN = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="{}"/>{}</joint>'


def urdf(joint: str, mass: str = 'value="1"') -> str:
    """Two links and what is said between them."""
    links = LINK.format("bb", 'value="1"') + LINK.format("cc", mass)
    return f'<robot name="a">{links}{joint}</robot>'


GOOD = TURN.format("jj", "continuous", "bb", "cc", "0 0 1", "")
MODELS = {
    "cut.urdf": (urdf(GOOD)[:90], ""),
    "no_robot.urdf": ("<mujoco/>", ".xml"),
    "no_joint.urdf": (urdf(""), "'bb' 'cc'"),
    "no_type.urdf": (urdf(TURN.format("jj", "hinge", "bb", "cc", "0 0 1", "")), "'jj' 'hinge'"),
    "floating.urdf": (urdf(TURN.format("jj", "floating", "bb", "cc", "1 0 0", "")),
                      "'jj' --weld-root"),
    "circle.urdf": (urdf(GOOD + TURN.format("kk", "continuous", "cc", "bb", "1 0 0", "")), "'bb'"),
    "negative.urdf": (urdf(GOOD, 'value="-1"'), "'cc' -1"),
    "typo.urdf": (urdf(GOOD, 'valeu="1"'), "'cc' mass value"),
    "empty.xml": ("<mujoco/>", "joint"),
    "ball.xml": ('<mujoco><worldbody><body name="a"><joint type="ball"/><geom size="1"/></body>'
                 "</worldbody></mujoco>", "'ball'"),
    "gone.xml": ('<mujoco><include file="none.xml"/></mujoco>', "none.xml"),
}  # fmt: skip
"""Content of each, and what its refusal names besides the file."""

KEYS = f"""
motion.duration=1e9 | motion.duration samples
motion.duration={"9" * 5000} | motion.duration
motion.duration={"w" * 500} | motion.duration {"w" * 50}
motion.duration | motion.duration
motion.duraton=7 | [motion] 'duraton' 'duration'
duration=3 | 'duration' motion.duration
motion.harmonics=2.5 | motion.harmonics
motion.fundamental=1e-12 | fundamental
motion.max_velocity.wrist=0.1 | 'wrist'
motion.file="a\\u0000b" | motion.file
name=../up | name
name.first=1 | 'name'
measurement.fault=[{{kind='plate'}}] | 'plate'
measurement.fault=[{{kind='plate_delay',late=1}}] | plate_delay 'late'
measurement.torque_constant_error.wrist=0.1 | 'wrist'
simulation.effect=[{{kind='payload',joint='hip'}}] | payload 'hip' elbow
simulation.effect=[{{kind='payload',mass=-1}}] | payload mass
simulation.bandwidth=1e6 | bandwidth
simulation.step=1e-320 | step
simulation.step=3e-4 | step
identification.cutoff=1e5 | position_cutoff cutoff
identification.terms=['slip'] | 'slip' coulomb
identification.zeros=['mb9x'] | 'mb9x' 'mb3x'
identification.span=[3,1] | span 3 1
robot.base="measured" | robot.base
robot.lock.hip=0 | 'hip' waist
robot.joint.hip.coulomb=1 | 'hip' elbow
expect={{torque_rms_relative_error={{}}}} | at_most
expect.speed.at_most=1 | 'speed'
consistent.prior_error=0 | prior_error
"""
"""Settings of `run table.toml`, and what a refusal names."""

ROBOT = "--model puma562.xml"
ONE = f"one.parquet {ROBOT}"
WORDS = f"""
run none.toml | 'none.toml'
run one.parquet | one.parquet
minimal none.xml | 'none.xml'
identify one.parquet --model ur5.urdf | waist j1
identify {ONE} --set motion.duration=3 | 'motion' identification
identify {ONE} --set identification.span=[50,60] | span 50
identify {ONE} --terms slip | 'slip' coulomb
identify {ONE} --consistent --write x.urdf | 'x.urdf' .xml
identify {ONE} --consistent --set consistent.known={{"mass/lnk3"=4}} | 'lnk3' 'link3'
identify {ONE} --plate map.toml | map.toml mapping
identify one.parquet one.parquet {ROBOT} | 'one.parquet'
identify no_wrench.parquet {ROBOT} --method external | wrench external
validate one.parquet none.json | 'none.json' identify
validate other.parquet result.json --model ur5.urdf | SHA-256
payload one.parquet other.parquet {ROBOT} --joint hip | 'hip' elbow
payload one.parquet other.parquet {ROBOT} --as abb | 'abb' kuka
tool one.parquet {ROBOT} --sensor link3 --as ur --json | --as
sample result.json --out . | '.' working
sample result.json --out run | 'run' --out
drives one.parquet {ROBOT} --unseen other.parquet | --write
drives no_torque.parquet {ROBOT} | torque
drives one.parquet {ROBOT} --friction friction.txt | 'friction.txt' .csv .json
calibrate {ONE} | --known
calibrate {ONE} --known mass=x | 'mass=x'
calibrate {ONE} --known mass=20 --known mbar1=20 | 'mbar1'
report run {ROBOT} | 'run' --model
report {ONE} --out x.pdf | --out 'x.pdf' .html
simulate table.toml | --out
campaign --summary none | none/results.parquet
excite two.urdf --check | 'two.urdf' model testbed new
excite two.urdf --set excitation.plate_range=[1,1,1,1,1,1] | plate
minimal puma562.xml --zero mb9x | 'mb9x' 'mb3x'
minimal puma562.xml --gravity 1,2 | --gravity '1,2'
equations puma562.xml --max-terms 5 | 5 --max-terms
equations puma562.xml --language fortran | --language 'fortran'
equations puma562.xml --against table.toml | line 1
import --guess log.csv --out map.toml | map.toml
new two.urdf --out table.toml | table.toml
fly | 'fly'
minimal puma562.xml --speed | --speed testbed minimal --help
simulate x.toml --out x.csv | testbed simulate --help
--nothing | testbed --help
"""
"""Words of a command, and what its refusal names."""

ANYTHING = f"""
IT
--IT
minimal IT
minimal puma562.xml --gravity IT
run IT
run table.toml --set IT=1
simulate IT --out r.parquet
view IT --save x.rrd
identify IT {ROBOT}
identify one.parquet --model IT
report IT {ROBOT} --out x.html
equations puma562.xml --against IT
"""
"""Commands that are given what they cannot take."""


def check(place: Path, words: list[str], culprits: list[str]) -> list[str]:
    """What is wrong with how a command refuses; nothing, if it does it well."""
    before = sorted(place.rglob("*"))
    done = command_line(*words, cwd=place)
    lines = done.stderr.removesuffix("\n").split("\n")
    said = lines[-1].removeprefix("testbed: ")
    wrong = [f"no word of {each}" for each in culprits if each not in said]
    wrong += [f"exit code {done.returncode}"] * (done.returncode != 2)
    wrong += ["says something on standard output"] * bool(done.stdout)
    wrong += ["more than a line"] * any(not each.startswith("note: ") for each in lines[:-1])
    wrong += ["no message"] * (not is_message(said) or not said.isprintable())
    wrong += ["leaves something"] * (sorted(place.rglob("*")) != before and "kept in" not in said)
    return [f"{' '.join(words)}: {each}: {said}" for each in wrong]


def table(text: str) -> list[tuple[str, list[str]]]:
    """Rows of words and what a refusal names."""
    rows = (row.partition(" | ") for row in text.strip().splitlines())
    return [(words, named.split()) for words, _, named in rows]


def test_what_is_wrong_is_named(place: Path, tmp_path: Path) -> None:
    """Settings, words, files: whoever mistypes is told what and where."""
    quick = ("motion.duration=4", "motion.candidates=2", "simulation.step=1e-3")
    start = ["run", "table.toml", *(word for each in quick for word in ("--set", each))]
    rows = [(place, [*start, "--set", key], named) for key, named in table(KEYS)]
    for words, named in table(WORDS):
        rows.append((place, shlex.split(words.replace('"', r"\"")), named))
    for name, (text, said) in MODELS.items():
        (tmp_path / name).write_text(text)
        rows.append((tmp_path, ["minimal", name], [name, *said.split()]))
    found = [wrong for row in rows for wrong in check(*row)]
    assert not found, "\n".join(found)


def test_words_and_files_of_any_kind_are_refused(place: Path, tmp_path: Path) -> None:
    """A folder, a pipe that nobody writes to, a link to itself, nothing: no command waits.

    Escape sequences, reversed text and bytes that are no text are shown harmlessly.
    """
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "empty").touch()
    odd = ["a\x1b[31m\u202eb\x9bc\u2066\n d", os.fsdecode(b"a\xff\xfe.xml")]
    found = []
    for words, _ in table(ANYTHING):
        for it in (*map(str, tmp_path.iterdir()), *odd):
            found += check(place, [word.replace("IT", it) for word in words.split()], [])
    assert not found, "\n".join(found)


FILES = {
    "model file": ("puma562.xml", "two.urdf"),
    "recording": ("one.parquet",),
    "log of another program": ("log.csv",),
    "result": ("result.json", "run/result.json"),
    "experiment": ("table.toml",),
    "campaign": ("quick.toml",),
    "mapping": ("map.toml",),
}
"""Files of each kind; see conftest.py."""

ASKED = {
    "identify FILE --model puma562.xml": ("recording", "mapping"),
    "identify one.parquet --model FILE": ("model file",),
    "validate one.parquet FILE": ("result",),
    "minimal FILE": ("model file",),
    "run FILE": ("experiment",),
    "campaign FILE": ("campaign",),
    "import FILE --out new.parquet": ("mapping",),
    "new FILE": ("model file",),
    "report FILE --model puma562.xml": ("recording", "mapping"),
    "view FILE --model puma562.xml --save new.rrd": ("recording", "mapping"),
    "excite FILE": ("model file", "experiment"),
    "identify one.parquet --model puma562.xml --plate FILE": (),
}
"""Commands, and kinds of the file that they take."""


def test_every_file_is_known_by_its_content(place: Path, tmp_path: Path) -> None:
    """Whatever its name is, but for logs, which may be anything."""
    for kind, names in FILES.items():
        for name in names:
            assert kind_of(place / name) == kind
            if "log" not in kind:
                assert kind_of(Path(shutil.copy(place / name, tmp_path / "any"))) == kind
    shipped = {"experiment": "experiments/*.toml", "campaign": "experiments/campaigns/*.toml"}
    for kind, pattern in shipped.items():
        assert {kind_of(path) for path in ROOT.glob(pattern)} == {kind}


@pytest.mark.parametrize("words", ASKED)
def test_a_command_says_what_it_was_given(words: str, place: Path, tmp_path: Path) -> None:
    shutil.copytree(place, home := tmp_path / "home")
    for kind, names in FILES.items():
        for name in names if kind not in ASKED[words] else ():
            done = command_line(*words.replace("FILE", name).split(), cwd=home)
            assert done.returncode == 2, (words, name)
            (line,) = done.stderr.replace(f"{home}/", "").splitlines()
            assert kind in line, line
            assert USAGE[kind].replace("{}", name) in line, line
            assert len(line) <= 300, line
