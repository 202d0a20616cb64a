"""Commands that are killed, interrupted, or meet a full disk while they replace their outputs.

Each command is carried out with two arguments, one after the other. Then the second is repeated
onto the outputs of the first under strace, which lets one of its system calls fail or sends a
signal there: the outputs of the first or of the second must stand there, to the last byte.
"""

from __future__ import annotations

import hashlib
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.csv as pc
import pyarrow.parquet as pq

from testbed.core.base.files import TEMPORARY_PREFIX
from testbed.importing.foreign_table import ForeignTable
from testbed.importing.readers import read_tables
from tests.helpers.paths import GOLDEN

FAILING = ("rename", "renameat2", "link", "mkdir", "fsync", "write", "pwrite64")
"""System calls that a full or broken disk refuses."""

TRACED = ",".join((*FAILING, "unlink", "unlinkat", "rmdir", "openat"))

SET = (
    "--set motion.duration=12 --set simulation.step=1e-3 --set measurement.rate=200 "
    "--set motion.candidates=1"
)
LOG = "a{}.parquet --model robot.urdf"
NEW = "new robot.urdf --recording l{}.csv --out out.toml --force"

WRITERS: dict[str, tuple[str, str]] = {
    "run": (f"run robot.toml {SET} --set seed={{}} --out out --force", "out"),
    "simulate": (f"simulate robot.toml {SET} --set seed={{}} --out out.parquet --force",
                 "out.parquet"),
    "report": (f"report {LOG} --out out.html --force", "out.html out.json"),
    "view": (f"view {LOG} --save out.rrd --force", "out.rrd"),
    "identify": (f"identify {LOG} --write out.urdf --force", "out.urdf"),
    "drives": (f"drives {LOG} --write out.urdf --friction out.csv --force", "out.urdf out.csv"),
    "calibrate": (
        "calibrate p1.parquet --model puma562.xml --known mass=2{} --known gain/Fz=1 "
        "--known gain/Mx=1 --out out.toml --force", "out.toml",
    ),
    "excite": (
        f"excite robot.toml {SET} --set excitation.starts=1 --set seed={{}} --out out.toml "
        "--trajectory out.csv --page out.html --force", "out.toml out.csv out.html",
    ),
    "equations": ("equations robot{}.urdf --out out.txt --force", "out.txt"),
    "sample": ("sample i{}.json -n 3 --out out --force", "out"),
    "import": ("import m{}.toml --model robot.urdf --out out.parquet --force", "out.parquet"),
    "guess": (
        "import --guess l{}.csv --model robot.urdf --out out.toml --page out.html --force",
        "out.toml out.html",
    ),
    # the recording is made of the mapping that stands there by then: each is replaced alone
    "new mapping": (NEW, "out.toml"),
    "new recording": (NEW, "out.parquet"),
    "new experiment": ("new robot{}.urdf --out out.toml --force", "out.toml"),
    "summary": ("campaign --summary c{}", "c2"),
}  # fmt: skip
"""Words and outputs of every command that replaces something; {} is 1 or 2."""

CAMPAIGN = """
name = "c"
claim = "as a witness"
experiment = "robot.toml"
set = ["motion.duration=4", "simulation.step=1e-3", "measurement.rate=200", "motion.candidates=1"]
replicates = 2
seed = {}
"""


@dataclass(frozen=True)
class Fault:
    """A system call that fails, or at which a signal comes.

    Attributes:
        call: Name of the system call.
        when: Number of the call, from 1, in its thread.
        what: `error=ENOSPC`, `signal=KILL` and so on.
        more: Another fault, as strace writes it.
    """

    call: str
    when: int
    what: str
    more: tuple[str, ...] = ()

    @property
    def options(self) -> list[str]:
        """Words for strace."""
        own = f"inject={self.call}:{self.what}:when={self.when}"
        return [word for each in (*self.more, own) for word in ("-e", each)]


def _content(place: Path, outputs: str) -> Mapping[str, str]:
    """Digests of all outputs in a folder, by path."""
    tops = [place / name for name in outputs.split()]
    files = [each for top in tops for each in (top, *top.rglob("*")) if each.is_file()]
    names = {str(each.relative_to(place)): each for each in files}
    return {name: _digest(each) for name, each in names.items() if TEMPORARY_PREFIX not in name}


def _digest(path: Path) -> str:
    """SHA-256 of a file; of Rerun's, which has other identifiers each time, of the numbers."""
    if path.suffix != ".rrd":
        return hashlib.sha256(path.read_bytes()).hexdigest()
    found = hashlib.sha256()
    for topic, table in sorted(read_tables(path).items()):
        if isinstance(table, ForeignTable):
            for name, values in table.column_values(table.columns).items():
                found.update(f"{topic} {name}".encode() + values.tobytes())
    return found.hexdigest()


def prepared(folder: Path) -> None:
    """Inputs of all commands."""
    shutil.copyfile(GOLDEN / "robots/pendulum.urdf", folder / "robot.urdf")
    text = (folder / "robot.urdf").read_text()
    run = partial(carried_out, folder)
    run("new robot.urdf --out robot.toml")
    run(f"simulate table6 {SET} --out p1.parquet")
    for k in (1, 2):
        (folder / f"robot{k}.urdf").write_text(text.replace("3.654014", f"3.{k}"))
        run(f"simulate robot.toml {SET} --set seed={k} --out a{k}.parquet")
        said = run(f"identify a{k}.parquet --model robot.urdf --json")
        (folder / f"i{k}.json").write_text(said)
        table = pq.read_table(folder / f"a{k}.parquet")
        kept = [n for n in table.column_names if n.split("/")[0] in ("time", "position", "torque")]
        pc.write_csv(table.select(kept), folder / f"l{k}.csv")
        run(f"import --guess l{k}.csv --model robot.urdf --out m{k}.toml")
        (folder / f"c{k}.toml").write_text(CAMPAIGN.format(k))
        run(f"campaign c{k}.toml --workers 0 --out c{k}")


def carried_out(folder: Path, words: str) -> str:
    """Standard output of a command in a folder, without strace.

    Raises:
        RuntimeError: The command is refused, or fails.
    """
    command = [sys.executable, "-m", "testbed", *words.split()]
    done = subprocess.run(command, cwd=folder, text=True, capture_output=True, check=False)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{words}: {done.stderr}")
    return done.stdout


def _traced(words: str, place: Path, faults: list[str]) -> subprocess.CompletedProcess[str]:
    """A command under strace, in a folder."""
    log = place.with_name("strace")
    shutil.rmtree(log, ignore_errors=True)
    log.mkdir()
    command = ["strace", "-ff", "-qq", "-e", f"trace={TRACED}", *faults]
    command += ["-o", str(log / "log"), sys.executable, "-m", "testbed", *words.split()]
    return subprocess.run(command, cwd=place, text=True, capture_output=True, check=False)


def _calls(log: Path) -> list[tuple[str, int]]:
    """System calls from the first that touches a temporary folder, with their numbers."""
    found: list[tuple[str, int]] = []
    for file in sorted(log.iterdir()):
        numbers: Counter[str] = Counter()
        begun = False
        for line in file.read_text(errors="replace").splitlines():
            match = re.match(r"(\w+)\(", line)
            if match is None:
                continue
            call = match[1]
            numbers[call] += 1
            begun = begun or TEMPORARY_PREFIX in line
            if begun:
                found.append((call, numbers[call]))
    return found


def _fault(name: str, calls: list[tuple[str, int]], rng: random.Random) -> Fault:
    """One fault of a random kind at a random call."""
    kind = rng.choice(["KILL", "INT", "TERM", "HUP", "ENOSPC", "EIO", "two"])
    if name == "excite" and kind == "INT":  # which ends its search with a third result
        kind = "TERM"
    if kind in ("KILL", "INT", "TERM", "HUP"):
        rare = rng.choice(sorted({call for call, _ in calls}))  # else most are `openat`
        call, when = rng.choice([each for each in calls if each[0] == rare])
        return Fault(call, when, f"signal={kind}")
    names = sorted({call for call, _ in calls if call in FAILING})
    rare = rng.choice(names)
    call, when = rng.choice([each for each in calls if each[0] == rare])
    if kind == "two":  # a file system that cannot exchange, and then fails
        steps = [("rename", k) for k in (1, 2, 3, 4)] + [("link", 1)]
        call, when = rng.choice(steps)
        what = rng.choice(["error=ENOSPC", "error=EIO", "signal=INT"])
        return Fault(call, when, what, ("inject=renameat2:error=EINVAL",))
    return Fault(call, when, f"error={kind}")


def kills(count: int, seed: int) -> dict[str, Any]:
    """Faults while outputs are replaced; the older ones or the new ones must stand there, whole."""
    rng = random.Random(f"{seed}/kills")
    ends: Counter[str] = Counter()
    broken: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        inputs = Path(folder) / "inputs"
        inputs.mkdir()
        prepared(inputs)
        for k, name in enumerate(WRITERS):
            share = count // len(WRITERS) + (k < count % len(WRITERS))
            ends.update(_of_one(name, inputs, share, rng, broken))
    return {"bench": "faults while replacing", **ends, "not treated well": broken}


def _of_one(
    name: str, inputs: Path, count: int, rng: random.Random, broken: list[str]
) -> Iterator[str]:
    """Which outputs stand there after each fault in one command."""
    words, outputs = WRITERS[name]
    old, new = (words.format(k) for k in (1, 2))
    old_place, place = inputs.with_name("old"), inputs.with_name("place")
    for folder in (old_place, place):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(inputs, folder)
    carried_out(old_place, old)
    shutil.rmtree(place)
    shutil.copytree(old_place, place)
    done = _traced(new, place, [])
    if done.returncode not in (0, 1):
        broken.append(f"{name}: {done.stderr[-300:]}")
        return
    states = {"old": _content(old_place, outputs), "new": _content(place, outputs)}
    calls = _calls(place.with_name("strace"))
    for _ in range(count):
        shutil.rmtree(place)
        shutil.copytree(old_place, place)
        fault = _fault(name, calls, rng)
        done = _traced(new, place, fault.options)
        found = _content(place, outputs)
        end = next((end for end, state in states.items() if state == found), "neither")
        pairs = {*states["old"].items(), *states["new"].items()}
        if end == "neither" and "KILL" in fault.what and pairs >= {*found.items()}:
            end = "killed between two files"  # each of them is whole
        yield end
        wrong = _wrong(end, done, fault, place)
        if wrong:
            broken.append(f"{name} {' '.join(fault.options)}: {wrong}: {done.stderr[-200:]}")


def _wrong(end: str, done: subprocess.CompletedProcess[str], fault: Fault, place: Path) -> str:
    """What is wrong with how a command ended; nothing if it ended well."""
    said = done.stderr.splitlines()
    there = [each.name for each in place.iterdir()]
    left = [name for name in there if name.startswith(TEMPORARY_PREFIX) or "-before-" in name]
    if end == "neither":
        return "neither the older outputs nor the new ones"
    if done.returncode in (0, 1) and end != "new":
        return "it says that it has done what it has not"
    if "KILL" in fault.what:
        return ""
    if "Traceback" in done.stderr or done.returncode == 70:
        return f"a traceback, exit code {done.returncode}"
    if any(TEMPORARY_PREFIX in line for line in said):
        return "a temporary folder in a message"
    return f"left behind: {left[0]}" if left and fault.call not in ("unlink", "rmdir") else ""
