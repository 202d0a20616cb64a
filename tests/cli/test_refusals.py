"""What is wrong with a command line is said in one line that names it, and nothing is left behind.

One table of wrong words; another of model files that are none.
"""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.helpers.command import command_line
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
LOW = '<limit lower="1" upper="-1" effort="1" velocity="1"/>'
MODELS = {
    "empty.urdf": ("", ""),
    "cut.urdf": (urdf(GOOD)[:90], ""),
    "no_robot.urdf": ("<mujoco/>", ".xml"),
    "no_joint.urdf": (urdf(""), "'bb' 'cc'"),
    "no_parent.urdf": (urdf(TURN.format("jj", "revolute", "xx", "cc", "0 0 1", "")), "'jj' 'xx'"),
    "no_type.urdf": (urdf(TURN.format("jj", "hinge", "bb", "cc", "0 0 1", "")), "'jj' 'hinge'"),
    "floating.urdf": (urdf(TURN.format("jj", "floating", "bb", "cc", "1 0 0", "")),
                      "'jj' --weld-root"),
    "no_axis.urdf": (urdf(TURN.format("jj", "continuous", "bb", "cc", "0 0 0", "")), "'jj' axis"),
    "two_axes.urdf": (urdf(TURN.format("jj", "continuous", "bb", "cc", "0 0", "")), "'jj' axis"),
    "low.urdf": (urdf(TURN.format("jj", "prismatic", "bb", "cc", "1 0 0", LOW)), "'jj' -1"),
    "circle.urdf": (urdf(GOOD + TURN.format("kk", "continuous", "cc", "bb", "1 0 0", "")), "'bb'"),
    "twice.urdf": (urdf(GOOD).replace('link name="bb"', 'link name="cc"'), "'cc'"),
    "negative.urdf": (urdf(GOOD, 'value="-1"'), "'cc' -1"),
    "word.urdf": (urdf(GOOD, 'value="x"'), "'cc' mass 'x'"),
    "typo.urdf": (urdf(GOOD, 'valeu="1"'), "'cc' mass value"),
    "no_child.urdf": (urdf('<joint name="jj" type="fixed"><parent link="bb"/></joint>'), "'jj'"),
    "no_name.urdf": (urdf("<joint/>"), "joint"),
    "empty.xml": ("<mujoco/>", "joint"),
    "no_model.xml": ("<robot/>", "URDF"),
    "ball.xml": ('<mujoco><worldbody><body name="a"><joint type="ball"/><geom size="1"/></body>'
                 "</worldbody></mujoco>", "'ball'"),
    "unknown.xml": ('<mujoco><worldbody><body nome="a"/></worldbody></mujoco>', "nome"),
    "gone.xml": ('<mujoco><include file="none.xml"/></mujoco>', "none.xml"),
}  # fmt: skip
"""Content of each, and what its refusal names besides the file."""

KEYS = """
motion.length=3 | length duration
motion=3 | motion 3
seed=x | seed 'x'
seed=-1 | seed -1
a.b.c=1 | 'a'
duration=20 | motion.duration
motion.duration=0 | motion.duration 0
motion.duration=nan | motion.duration nan
motion.duration=1e9 | motion.duration samples
simulation.step=1 | simulation.step 0.001
simulation.step=1e-9 | simulation.step 1e-09
measurement.rate=0.1 | measurement.rate 0.1
measurement.fault=[{kind='plate'}] | 'plate'
measurement.fault=[{kind=3}] | kind
measurement.fault=[{kind='plate_delay',late=1}] | plate_delay 'late'
measurement.fault=[{kind='plate_bias',force=[1,2]}] | plate_bias force
simulation.effect=[{kind='wind'}] | 'wind'
simulation.effect=[{kind='payload',mass=-1}] | payload mass -1
simulation.effect=[{kind='payload',joint='hip'}] | payload 'hip' elbow
identification.cutoff=-1 | cutoff -1
identification.cutoff=1e5 | position_cutoff cutoff
identification.terms=['slip'] | 'slip' coulomb
identification.nuisances=['wind'] | 'wind' bias
identification.zeros=['mb9x'] | 'mb9x' 'mb3x'
identification.known={mass='x'} | known.mass 'x'
identification.span=[3,1] | span 3 1
identification.drives='some' | identification.drives 'some' 'given'
robot.lock.hip=0 | 'hip' waist
robot.lock.elbow=99 | 'elbow' 99
robot.joint.hip.coulomb=1 | 'hip' elbow
robot.joint.elbow.coulomb=-1 | elbow.coulomb -1
gravity=[0,0] | gravity 3
expect.speed.at_most=1 | 'speed'
expect.external_max_z.at_most='x' | external_max_z 'x'
motion.file='none.toml' | none.toml
model='x' | x'
consistent.metric=3 | consistent.metric 'log-det'
"""
"""Settings of `run table.toml`, and what a refusal names."""

ROBOT = "--model puma562.xml"
ONE = f"one.parquet {ROBOT}"
WORDS = f"""
run none.toml | 'none.toml'
run puma562.xml | 'puma562.xml' testbed new
run one.parquet | one.parquet
run ../table6 | table6
minimal none.xml | 'none.xml'
minimal table.toml | table.toml XML
identify none.parquet {ROBOT} | 'none.parquet'
identify puma562.xml {ROBOT} | '.xml' .parquet
identify one.parquet --model ur5.urdf | waist j1
identify {ONE} --set motion.duration=3 | 'motion' identification
identify {ONE} --set identification.cutof=3 | 'cutof' 'cutoff'
identify {ONE} --set identification.span=[50,60] | span 50
identify {ONE} --terms slip | 'slip' coulomb
identify {ONE} --method magic | --method 'magic' 'both'
identify {ONE} --threads 0 | --threads 1
identify {ONE} --in-place | --in-place --write
identify {ONE} --consistent --write x.urdf | 'x.urdf' .xml
identify {ONE} --write puma562.xml | 'puma562.xml' --in-place
identify {ONE} --set consistent.metric=frobenius | --consistent
identify {ONE} --consistent --set consistent.known.mass=-3 | mass -3
identify {ONE} --consistent --set consistent.known={{"mass/lnk3"=4}} | 'lnk3' 'link3'
identify {ONE} --plate none.toml | none.toml
identify {ONE} --plate map.toml | map.toml numbers
identify one.parquet one.parquet {ROBOT} | 'one.parquet'
identify one.parquet | --model
identify no_wrench.parquet {ROBOT} --method external | wrench external
identify no_torque.parquet {ROBOT} --method internal | torque internal
identify map.toml {ROBOT} | waist j1
validate one.parquet none.json | 'none.json' identify
validate one.parquet table.toml | table.toml JSON
validate other.parquet result.json --model ur5.urdf | SHA-256
validate other.parquet result.json --gravity nan,0,0 | gravity
payload one.parquet none {ROBOT} | 'none'
payload one.parquet other.parquet {ROBOT} --joint hip | 'hip' elbow
payload one.parquet other.parquet {ROBOT} --at-rest | rest
drives no_torque.parquet {ROBOT} | torque
drives no_wrench.parquet {ROBOT} | wrench
calibrate {ONE} | --known
calibrate {ONE} --known mass | 'mass' mass=20
calibrate {ONE} --known mass=x | 'mass=x'
calibrate {ONE} --known gain/Fq=1 | 'gain/Fq' 'gain/Fz'
calibrate {ONE} --known mass=20 --known mbar1=20 | 'mbar1'
calibrate {ONE} --known mass=20 --joint elbow | --joint --loaded
report none | 'none'
report on | 'on' one.parquet
report table.toml | 'table.toml' --model
report run {ROBOT} | 'run' --model
report run --validate other.parquet | 'run' --model
report {ONE} --out x.pdf | --out 'x.pdf' .html
view {ONE} --save x.png | --save 'x.png' .rrd
view one.parquet --save x.rrd | 'one.parquet' --model
simulate table.toml | --out
simulate table.toml --out x.txt | --out 'x.txt' .parquet
compare table.toml | table.toml variant
campaign table.toml | table.toml experiment
campaign quick.toml --workers -1 | --workers 0
campaign quick.toml --limit 0 | --limit 1
campaign quick.toml --tls-key log.csv | --tls-ca --tls-cert
campaign quick.toml --tls-key log.csv --tls-ca log.csv --tls-cert none.pem | 'none.pem'
campaign quick.toml --tls-key log.csv --tls-ca log.csv --tls-cert log.csv | TLS --scheduler
campaign quick.toml --workers 1 --scheduler tcp://127.0.0.1:1 | --workers --scheduler
campaign --summary none | 'none' results.parquet
excite none.xml | none.xml
excite two.urdf --trajectory t.txt | 't.txt' .csv
excite two.urdf --rate 0 | --rate
excite two.urdf --check | two.urdf TOML
excite none.toml --check | none.toml
excite two.urdf --check --page x.html --trajectory t.csv | --trajectory --page
excite two.urdf --prior table.toml | table.toml JSON
excite two.urdf --out m.txt | --out 'm.txt' .toml
excite two.urdf --set excitation.starts=0 | excitation.starts 0
excite two.urdf --set excitation.plate_range=[1,1,1,1,1,1] | plate
minimal puma562.xml --zero mb9x | 'mb9x' 'mb3x'
minimal puma562.xml --terms slip | 'slip' coulomb
minimal puma562.xml --gravity 1,2 | --gravity '1,2'
minimal puma562.xml --lock hip | 'hip' elbow
minimal puma562.xml --lock elbow=x | 'elbow=x'
minimal puma562.xml --lock elbow=50 | 'elbow' 50
equations puma562.xml --max-terms 5 | 5 --max-terms
equations puma562.xml --max-terms 0 | --max-terms 1
equations puma562.xml --language fortran | --language 'fortran'
equations puma562.xml --zeros --zero mb1x | --zeros --zero
equations puma562.xml --against none.txt | none.txt
equations puma562.xml --against table.toml | line 1
equations puma562.xml --against map.toml --json | --against --json
import map.toml | --out
import map.toml --align --out x.parquet | --align --model
import none.toml --out x.parquet | 'none.toml'
import --guess log.csv --out map.toml | map.toml
import --guess log.csv --page x.html | --page --model
new none.urdf | 'none.urdf'
new two.urdf --out table.toml | table.toml
new | --recording
faults plate_wind | 'plate_wind' 'plate_gain'
effects wind | 'wind' effects
fly | 'fly'
run --live | FILE
minimal puma562.xml --speed | --speed
warmup x | x
doctor now | now
"""
"""Words of a command, and what its refusal names."""


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
    wrong += ["no message"] * (not is_message(said))
    wrong += ["leaves something"] * (sorted(place.rglob("*")) != before and "kept in" not in said)
    return [f"{' '.join(words)}: {each}: {said}" for each in wrong]


def table(text: str) -> list[tuple[str, list[str]]]:
    """Rows of words and what a refusal names."""
    rows = (row.partition(" | ") for row in text.strip().splitlines())
    return [(words, named.split()) for words, _, named in rows]


def test_wrong_settings_are_named(place: Path) -> None:
    quick = ("motion.duration=4", "motion.candidates=2", "simulation.step=1e-3")
    start = ["run", "table.toml", *(word for each in quick for word in ("--set", each))]
    rows = [([*start, "--set", key], named) for key, named in table(KEYS)]
    found = [wrong for row in rows for wrong in check(place, *row)]
    assert not found, "\n".join(found)


def test_wrong_words_and_files_are_named(place: Path) -> None:
    rows = [(shlex.split(words.replace('"', r"\"")), named) for words, named in table(WORDS)]
    found = [wrong for row in rows for wrong in check(place, *row)]
    assert not found, "\n".join(found)


def test_model_files_that_are_none_are_named(place: Path, tmp_path: Path) -> None:
    for name, (text, _) in MODELS.items():
        (tmp_path / name).write_text(text)
    rows = [(["minimal", name], [name, *named.split()]) for name, (_, named) in MODELS.items()]
    found = [wrong for row in rows for wrong in check(tmp_path, *row)]
    assert not found, "\n".join(found)
