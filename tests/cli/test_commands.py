"""Every command once, as a person or a program calls it; terminal, page and JSON say the same."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import testbed as tb
from testbed.cli.commands import app
from testbed.core.recordings.metadata import Metadata
from tests.helpers.command import command_line
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow

QUICK = "--set motion.duration=3 --set motion.candidates=2 --set simulation.step=1e-3"
ROBOT = "--model puma562.xml"
RESULT = (
    "as_expected claim consistent diagnostics drives estimates expect failures format model name "
    "plain posterior score settings source validation verdict verdicts"
)
"""Keys of a run's and of a recording's."""
COMMANDS = {
    "minimal": ("minimal puma562.xml --zeros --verify --terms rotor --map --json",
                "S drives gravity joints map parameters robot torque verified wrench"),
    "minimal, latex": ("minimal puma562.xml --latex --tared --zero mb1x", ""),
    "equations": ("equations puma562.xml --what gravity-forces --zeros --json",
                  "constants equations form gravity robot text"),
    "simulate": (f"simulate table.toml {QUICK} --out OUT/s.parquet", ""),
    "run": (f"run table.toml {QUICK} --set expect={{}} --all --out OUT/run", ""),
    "run, claim": (f"run table.toml {QUICK} --set seed=7 --out OUT/claim --json "
                   "--set expect.wrench_max_z.at_most=1e-9", f"{RESULT} folder"),
    "identify": (f"identify one.parquet {ROBOT} --zeros --all --json",
                 RESULT),
    "identify, plate": (f"identify one.parquet {ROBOT} --zeros --plate OUT/plate.toml --json",
                        RESULT),
    "identify, write": (f"identify one.parquet {ROBOT} --write OUT/made.xml --json",
                        RESULT),
    "validate": ("validate other.parquet result.json --json", "wrench torque"),
    "calibrate": (f"calibrate one.parquet {ROBOT} --zeros --known mass=20 --known gain/Fz=1+-1e-3 "
                  "--out OUT/plate.toml --json",
                  "correlation estimate known matrix matrix_sigma numbers robot"),
    "drives": (f"drives one.parquet {ROBOT} --zeros --json",
               "combined curves delay diagnostics estimates"),
    "drives, write": (f"drives ahead.parquet {ROBOT} --zeros --commands --write OUT/driven.xml "
                      "--unseen other.parquet --json",
                      "combined curves delay diagnostics estimates"),
    "sample": ("sample result.json -n 3 --out OUT/robots --json",
               "joints links mean names prior_error share sigma"),
    "sample, run": ("sample run -n 3 --out OUT/drawn", ""),
    "payload": (f"payload one.parquet other.parquet {ROBOT} --json",
                "centre covariance diagnostics identifiable joint names p_value rank sigma "
                "unidentifiable units values"),
    "tool": (f"tool one.parquet {ROBOT} --sensor link3 --json",
             "centre covariance diagnostics identifiable joint names p_value rank sigma "
             "unidentifiable units values"),
    "report": ("report OUT/run --out OUT/run.html", ""),
    "view": (f"view OUT/run no_torque.parquet {ROBOT} --save OUT/run.rrd", ""),
    "campaign": ("campaign quick.toml --workers 0 --out OUT/many", ""),
    "campaign, plan": ("campaign quick.toml --dry-run --limit 3", ""),
    "campaign, summary": ("campaign --summary OUT/many", ""),
    "excite": ("excite two.urdf --set excitation.starts=1 --set excitation.harmonics=2 --set "
               "motion.duration=6 --out OUT/m.toml --page OUT/m.html --trajectory OUT/m.csv --json",
               "complete criterion diagnostics file fundamental gain harmonics predicted proof "
               "random searches value"),
    "excite, check": ("excite OUT/m.toml --check --json",
                      "binding instants is_valid margins postures"),
    "excite, exceeded": ("excite OUT/m.toml --check --set motion.max_velocity={j1=0.01} --json",
                         "binding instants is_valid margins postures"),
    "view, motion": ("view OUT/m.toml --save OUT/m.rrd", ""),
    "import": ("import map.toml --out OUT/i.parquet --json", "clocks diagnostics import"),
    "import, guess": ("import --guess log.csv", ""),
    "new": ("new two.urdf --out OUT/two.toml", ""),
    "new, recording": ("new --recording log.csv --out OUT/log.toml", ""),
    "doctor": ("doctor --json", "checks"),
    "doctor, compile": ("doctor --compile", ""),
    "list": ("list", ""),
}  # fmt: skip
"""Words of each, and the keys of its JSON, where it can speak to programs as well as to people."""
FIRST = {
    "report": "run", "view": "run", "campaign, summary": "campaign",
    "excite, check": "excite", "excite, exceeded": "excite",
    "view, motion": "excite", "identify, plate": "calibrate",
}  # fmt: skip
"""What must have run before."""
WRITTEN = r"--(?:out|page|trajectory|save|write) OUT/(\S+)"
"""Files of a command's own, which the same command writes again with --force."""
FAILS = ("run, claim", "excite, exceeded")
"""What does all it is asked to, and ends with 1: a claim or a limit does not hold."""

Done = CompletedProcess[str]
Told = Callable[..., Done]


def answer(words: str, cwd: Path) -> Any:
    """The JSON that a command prints."""
    return json.loads(command_line(*shlex.split(words), "--json", cwd=cwd).stdout)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="module")
def told(place: Path, out: Path) -> Told:
    """How a command ends; each runs once."""

    @cache
    def tell(name: str, text: bool = False) -> Done:
        if name in FIRST:
            tell(FIRST[name])
        words = COMMANDS[name][0].replace(" --json" * text, "")
        words += " --force" * (text and bool(re.search(WRITTEN, words)))
        words = words.replace("OUT", str(out))
        return command_line(*shlex.split(words), cwd=place)

    return tell


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_does_what_it_is_asked_to(name: str, told: Told, out: Path) -> None:
    """With what it says on standard output, JSON of known keys or text, and files it names."""
    words, keys = COMMANDS[name]
    for done in (told(name), *([told(name, text=True)] if keys else [])):
        assert done.returncode == (1 if name in FAILS else 0), done.stderr
        assert all(line.startswith("note: ") for line in done.stderr.splitlines()), done.stderr
        assert done.stdout.strip()
    if keys:
        assert " ".join(sorted(json.loads(told(name).stdout))) == " ".join(sorted(keys.split()))
    written = re.findall(WRITTEN, words)
    assert [each for each in written if not (out / each).exists()] == []


def test_every_command_is_here_and_helps_with_an_example() -> None:
    known = {command.name or command.callback.__name__: command.callback  # type: ignore[union-attr]
             for command in app.registered_commands}  # fmt: skip
    assert {words.split()[0] for words, _ in COMMANDS.values()} == set(known)
    for name in known:
        helped = CliRunner().invoke(app, [name, "--help"])
        assert helped.exit_code == 0
        assert f"testbed {name}" in " ".join(helped.stdout.split()).partition("Example: ")[2]


def shows(text: str, name: str, number: float) -> bool:
    """Whether a row of a name holds a number, rounded as it stands there."""
    for line in text.splitlines():
        first, *cells = re.split(r"\s{2,}|[│|]", line.strip(" │"))
        if first.strip() == name:
            for each in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]\d+)?", " ".join(cells)):
                digits, _, power = each.partition("e")
                last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
                if abs(float(each) - number) <= 0.501 * last:
                    return True
    return False


def figures(command: str, found: Any) -> Iterator[tuple[str, float]]:
    """Numbers of a command's JSON that people are shown, with what they stand beside."""
    if command == "identify":
        for each in found["estimates"].values():
            for key in ("values", "sigma"):
                yield from zip(each["names"], each[key], strict=True)
    elif command == "validate":
        for each in found.values():
            for key in ("residual", "mean", "noise", "ratio"):
                yield from zip(each["channels"], each[key], strict=True)
    elif command == "drives":
        for each in found["estimates"]:
            values = (each["constant"], *(term["value"] for term in each["terms"]))
            yield from ((each["joint"], value) for value in values)
    elif command == "payload":
        each = zip(found["names"], found["values"], found["identifiable"], strict=True)
        yield from ((name, value) for name, value, told in each if told)
    else:
        for channel, row in zip(("Fx", "Fy", "Fz", "Mx", "My", "Mz"), found["matrix"], strict=True):
            yield from ((channel, number) for number in row)


def test_the_terminal_shows_the_numbers_of_the_json(told: Told) -> None:
    """Whoever reads and whoever computes goes on with the same figures."""
    for command in ("identify", "validate", "drives", "payload", "calibrate"):
        text, found = told(command, text=True).stdout, json.loads(told(command).stdout)
        wanted = [(name, number) for name, number in figures(command, found) if number is not None]
        assert len(wanted) >= 9
        assert [each for each in wanted if not shows(text, *each)] == [], command
    minimal, text = json.loads(told("minimal").stdout), told("minimal", text=True).stdout
    for model in ("torque", "wrench"):
        assert [name for name in minimal[model]["names"] if name not in text] == []
    assert told("equations", text=True).stdout == json.loads(told("equations").stdout)["text"]


def test_stages_of_an_identification_are_told_beside_its_result(place: Path) -> None:
    """Else nobody knows what a long one is waiting for, or programs cannot read the result."""
    words = ("identify", "one.parquet", "--model", "puma562.xml", "--zeros", "--json", "--timings")
    done = command_line(*words, cwd=place)
    assert json.loads(done.stdout) == json.loads((place / "result.json").read_text())
    seconds = [float(line.split()[0]) for line in done.stderr.splitlines()[-8:]]
    assert min(seconds) >= 0


def test_a_calibrated_plate_is_taken_back_and_its_doubt_is_in_sigma(told: Told) -> None:
    """Else a plate that is known to a percent would promise a thousandth."""
    assert told("calibrate").returncode == 0
    found = (json.loads(told(name).stdout) for name in ("identify", "identify, plate"))
    plain, by_plate = (each["estimates"]["wrench"] for each in found)
    assert plain["names"] == by_plate["names"]
    assert plain["values"] != by_plate["values"]
    pairs = zip(plain["sigma"], by_plate["sigma"], strict=True)
    both = [pair for pair in pairs if None not in pair]
    assert len(both) >= 9
    assert all(after > before for before, after in both)


def test_a_run_of_another_experiment_is_replaced_by_force_only(told: Told, out: Path) -> None:
    assert told("run, claim").returncode == 1
    folder, place = out / "claim", out.parent
    before = (folder / "result.json").read_bytes()
    words = shlex.split(f"run table6 {QUICK} --set expect={{}} --out {folder}")
    assert command_line(*words, cwd=place).returncode == 2
    assert (folder / "result.json").read_bytes() == before
    assert command_line(*words, "--force", cwd=place).returncode == 0
    assert json.loads((folder / "result.json").read_text())["expect"] == {}


def test_gravity_is_a_vector_however_it_is_written(place: Path) -> None:
    one, other = (
        answer(f"minimal two.urdf --gravity {way}", place) for way in ("0,0,-1.62", "0 0 -1.62")
    )
    assert one == other
    assert one["gravity"] == [0, 0, -1.62]


def test_drives_and_plate_are_calibrated_though_a_joint_rests(place: Path, tmp_path: Path) -> None:
    """As of the robot that has this joint locked; witness: the recording without its column."""
    words = [*shlex.split(QUICK.replace("--set", "")), "robot.lock={elbow=0.5}"]
    words += ["measurement.torque_constant_error={waist=0.05}"]
    two = tb.record(tb.Experiment.from_toml(place / "table.toml", words))
    still = np.full((len(two.time), 1), 0.5)
    three = tb.Recording(
        (*two.names, "elbow"), two.time, np.hstack([two.measured("position"), still]),
        np.hstack([two.measured("torque"), 0 * still]), two.wrench, tare=two.tare,
    )  # fmt: skip
    three.save(tmp_path / "three.parquet")
    two.save(tmp_path / "two.parquet")
    for command in ("drives", "calibrate --known mass=20 --known gain/Mx=1 --force"):
        command += f" --model {place / 'puma562.xml'}"
        held = answer(f"{command} two.parquet --lock elbow=0.5", tmp_path)
        assert answer(f"{command} three.parquet", tmp_path) == held, command


def test_the_verdict_is_first_and_what_it_is_about_is_validated(place: Path, out: Path) -> None:
    """Of the file as prior, or by least squares where a person asks for that."""
    tree = robot("puma")
    slow = replace(measured(tree, 5, speed=0.1), wrench=None, metadata=Metadata(mapping={}))
    slow.save(out / "slow.parquet")
    for held, more in (("posterior", ""), ("plain", "--plain")):
        words = f"identify {out / 'slow.parquet'} {ROBOT} {more}"
        text, said = command_line(*words.split(), cwd=place).stdout, answer(words, place)
        (out / "said.json").write_text(json.dumps(said))
        first, codes = said["verdict"][0], [each["code"] for each in said["verdict"]]
        start = " ".join(text.replace("│", " ").split())
        assert start.find(first["text"]) in range(len("warning: ╭╮ ") + 140)
        assert (codes == ["verdict.well"]) == (first["level"] == "info")
        assert "no-signal" not in {each["code"].partition(".")[2] for each in said["verdict"]}
        words = f"validate other.parquet {out / 'said.json'}"
        found = answer(words, place)["torque"]
        candidates = found["errors"]["residual"]
        assert found["held"] == held
        assert {"file", "refitted", "plain", "posterior"} <= {*candidates}
        assert found["residual"] == pytest.approx(candidates[held], rel=1e-9)
        shown = command_line(*words.split(), cwd=place).stdout
        numbers = [f"{each:.3g}" for each in (*candidates["file"], *candidates[held])]
        assert all(number in shown for number in numbers)


TX40 = ROOT / "examples/tx40"
MODEL = ("--model", str(TX40 / "tx40.urdf"))
TERMS = 'identification.terms=["coulomb","viscous","offset"]'


def altered(folder: Path, old: str, new: str, name: str = "map.toml") -> None:
    """The TX40's mapping with other words."""
    text = (TX40 / "tx40.toml").read_text()
    assert old in text
    for data in ("pos_read_data.csv.gz", "curr_data.csv.gz"):
        text = text.replace(f'"{data}"', json.dumps(str(TX40 / data)))
    (folder / name).write_text(text.replace(old, new))


def test_a_real_recording_is_imported_identified_and_looked_at(tmp_path: Path) -> None:
    """Two halves of it: one gives the estimate, the other judges it; no truth anywhere."""
    for name, cut in (("first", "stop = 4.6"), ("second", "start = 4.6")):
        altered(tmp_path, "rate = 500\n", f"rate = 500\n{cut}\n", f"{name}.toml")
    done = command_line("import", "first.toml", "--out", "r.parquet", *MODEL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = command_line("identify", "r.parquet", *MODEL, "--set", TERMS, "--json", cwd=tmp_path)
    (tmp_path / "result.json").write_text(said.stdout)
    found = json.loads(said.stdout)
    left = np.array(found["estimates"]["torque"]["residual"])
    assert np.sqrt(np.mean(left[:4] ** 2)) < 0.75  # N m, of literature's fits of these data
    added = found["posterior"]["torque"]
    assert added["used"]
    assert len(added["determined"]) < added["count"]
    judged = answer(f"validate second.toml result.json {shlex.join(MODEL)}", tmp_path)["torque"]
    total = {name: np.linalg.norm(each) for name, each in judged["errors"]["residual"].items()}
    assert total["posterior"] < total["refitted"] < total["file"]
    words = ("report", "first.toml", *MODEL, "--validate", "second.toml", "--out", "page.html")
    more = ("--terms", "auto", "--consistent", "--set", "identification.cutoff=10")
    done = command_line(*words, *more, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    page = json.loads((tmp_path / "page.json").read_text())
    assert "truth" not in page["parameters"][0]["heads"]
    assert len(page["posterior"]) >= 3  # errors by halves and on the other one, and shares
    assert [section["id"] for section in page["figures"]] == ["prediction", "spectra", "bodies"]
    shown = command_line("view", "first.toml", *MODEL, "--save", "r.rrd", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr


def test_a_mistake_in_a_mapping_is_refused_with_its_cure(tmp_path: Path) -> None:
    """By every command that takes it; imported unchecked, by the next."""
    altered(tmp_path, "[0, -1.5707963267948966", "[0, 0")
    unchecked = ("import", "map.toml", "--out", "x.parquet", "--unchecked")
    for words, code, files in (
        (("import", "map.toml", "--out", "x.parquet"), 2, {"map.toml"}),
        (("report", "map.toml"), 2, {"map.toml"}),
        (unchecked, 0, {"map.toml", "x.parquet"}),
        (("identify", "x.parquet"), 2, {"map.toml", "x.parquet"}),
    ):
        done = command_line(*words, *MODEL, cwd=tmp_path)
        assert done.returncode == code, words
        assert ("offset = [0, -1.5708, 1.57079" in done.stderr) == (code == 2)
        assert {path.name for path in tmp_path.iterdir()} == files
