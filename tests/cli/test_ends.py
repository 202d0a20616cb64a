"""How commands begin and end: the doctor, progress; exit codes, Ctrl-C, a full disk, no reader."""

from __future__ import annotations

import errno
import os
import shlex
import shutil
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from testbed.cli import main, starting
from testbed.core.base.errors import MAX_MESSAGE_LENGTH, ModelError, TestbedError, UnknownName
from testbed.view.output import Progress
from tests.helpers.command import CLI, command_line
from tests.helpers.modules import MODULES
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

ENDS: list[tuple[BaseException, int, str]] = [
    (ModelError("r.urdf: no robot"), 2, "r.urdf: no robot"),
    (UnknownName("joint", "ellbow", ("elbow", "waist")), 2, "'elbow'"),
    (OSError(errno.ENOSPC, "No space left on device", "a.rrd"), 2, "'a.rrd': No space left"),
    (OSError("odd"), 2, "odd"),
    (MemoryError(), 2, "memory"),
    (RecursionError(), 2, "nested"),
    (UnicodeDecodeError("utf-8", b"ab\xff", 2, 3, "invalid start byte"), 2, "byte 2"),
    (ModelError("a " * 10**6), 2, "a a a"),
    (ModelError("\x1b[2J\u202e\r\nb\x85c"), 2, r"\x1b[2J\u202e b c"),
    (ImportError("no libGL"), 70, "no libGL"),
    (ZeroDivisionError("of ours"), 70, "ZeroDivisionError: of ours"),
    (BrokenPipeError(errno.EPIPE, "Broken pipe"), 141, ""),
]
"""What may happen, the exit code, and what is said of it."""


def process(words: list[str], shell: str = "{}", **around: str) -> subprocess.CompletedProcess[str]:
    """A command of its own, as a shell runs it."""
    script = shell.format(shlex.join(words))
    return subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, check=False, cwd=ROOT,
        env=os.environ | around,
    )  # fmt: skip


def program(body: str) -> list[str]:
    """Words of the program with another command in the place of its own."""
    code = f"from testbed.cli import main\ndef command():\n    {body}\n"
    return [sys.executable, "-c", f"{code}main._command = command\nmain.main()"]


def test_whatever_happens_is_one_line_and_an_exit_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A fault of the program comes with all that a report needs; it is no failed claim."""
    for error, code, said in ENDS:
        monkeypatch.setattr(main, "_command", Mock(side_effect=error))
        done = command_line(cwd=tmp_path)
        lines = done.stderr.removesuffix("\n").split("\n")
        assert (done.returncode, done.stdout) == (code, ""), error
        assert said in done.stderr
        assert lines[-1].startswith("testbed: " if said else "")
        assert lines[-1].isprintable()
        assert len(lines) == 1 or "of ours" in said
        assert len(lines[-1]) <= MAX_MESSAGE_LENGTH + len("testbed: ")


def test_output_that_nobody_takes(place: Path) -> None:
    """A full disk is said once; a reader that has gone, or closed streams, need no word."""
    words = [*CLI, "minimal", str(place / "two.urdf")]
    full = process(words, "{} > /dev/full")
    assert (full.returncode, full.stderr) == (2, "testbed: No space left on device\n")
    for shell, codes in (("{} >&-", (0,)), ("set -o pipefail; {} | true", (0, 141))):
        done = process(words, shell)
        assert done.returncode in codes
        assert done.stderr == ""
    for shell in ("{} 2>&- >&- <&-", "{} 2> /dev/full"):
        done = process([*CLI, "minimal", "nowhere.xml"], shell)
        assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


def test_ctrl_c_is_one_line_then_the_end() -> None:
    """Also where a library turns it into an error of its own; a second one ends at once.

    The same by the signals of another process and of a terminal that is closed.
    """
    kill = "import os, signal\n    try: os.kill(os.getpid(), signal.SIGINT)\n    "
    said = process(program(f"{kill}except KeyboardInterrupt: raise ImportError('no numpy')"))
    assert (said.returncode, said.stderr) == (130, "testbed: interrupted\n")
    twice = process(program(f"{kill}finally: os.kill(os.getpid(), signal.SIGINT)"), "exec {}")
    assert (twice.returncode, twice.stderr) == (-signal.SIGINT, "")
    for number in ("INT", "TERM", "HUP"):
        ended = kill.replace("SIGINT", f"SIG{number}") + "finally: pass\n    return 0"
        heard, ignored = process(program(ended)), process(program(ended), f"trap '' {number}; {{}}")
        assert (heard.returncode, heard.stderr) == (130, "testbed: interrupted\n")
        assert (ignored.returncode, ignored.stderr) == (0, "")


def test_ctrl_c_ends_a_search_with_the_best_motion_so_far(place: Path, tmp_path: Path) -> None:
    """It is proven and written like any other."""
    words = ["excite", str(place / "two.urdf"), "--set", "excitation.starts=10000"]
    with subprocess.Popen(
        [*CLI, *words, "--set", "motion.duration=6"], cwd=tmp_path, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    ) as run:  # fmt: skip
        assert run.stderr is not None
        # it has begun to search; the kernel may be compiled before
        assert any(line.startswith("note: ") for line in run.stderr)
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=120)
    assert run.returncode == 0
    assert command_line("excite", "motion.toml", "--check", cwd=tmp_path).returncode == 0


def test_starting_loads_only_what_is_needed(place: Path) -> None:
    """Help nothing heavy; `minimal` no physics engine, which would look for a window."""
    code = "import sys\nfrom testbed.cli import main, options\nprint(*sys.modules)\n"
    code += "sys.argv[1:] = ['minimal', sys.argv[1]]\n"
    code += "try: main.main()\nfinally: print(*sys.modules)"
    first, *_, last = process(
        [sys.executable, "-c", code, str(place / "two.urdf")]
    ).stdout.splitlines()
    heavy = {"mujoco", "pinocchio", "scipy", "pyarrow", "rerun", "numpy", "numba", "matplotlib"}
    assert heavy & set(first.split()) == set()
    assert heavy & set(last.split()) == {"pinocchio", "numpy"}


PUMA = "one.parquet --model puma562.xml"
LONG = {
    "lab.experiment.record:record": "simulate table.toml --out x.parquet",
    "lab.experiment.carry_out:record": "run table.toml",
    "lab.experiment.carry_out:evaluate": "run table.toml --set motion.duration=2",
    "lab.experiment.new_experiment:new_experiment": "new two.urdf",
    "lab.experiment.run:assemble_run": f"report {PUMA}",
    "importing.convert:import_recordings": "import map.toml --out x.parquet",
    "importing.guess:guess_mapping": "import --guess log.csv",
    "importing.check.check:import_and_check": "import map.toml --out x.parquet --model two.urdf",
    "applications.analysis:identify_problem": f"identify {PUMA}",
    "applications.drives.identify_drives:identify_drives": f"drives {PUMA}",
    "core.estimation.identify:identify": "payload one.parquet " + PUMA,
    "applications.analysis:consistent": f"identify {PUMA} --consistent",
    "applications.calibration:calibrate": f"calibrate {PUMA} --known mass=20",
    "view.viewer.log:write_runs_rrd": f"view {PUMA} --save x.rrd",
    "campaigns.conduct:conduct": "campaign quick.toml --workers 0",
    "core.kernel.warm_up:warm_up": "doctor --compile",
}  # fmt: skip
"""What may take long, and the command that does it."""


def test_nothing_long_is_silent(place: Path, tmp_path: Path) -> None:
    """What is long ends at once here, and leaves word whether its progress was shown."""
    home = tmp_path / "home"
    shutil.copytree(place, home)
    for module in MODULES:  # one that is first imported below would keep what stands in for another
        if not module.endswith("__main__"):
            import_module(module)
    for long, words in LONG.items():
        module, _, function = long.partition(":")
        shown: list[bool] = []

        def ended(*_: Any, seen: list[bool] = shown, **__: Any) -> Any:
            seen.append(bool(Progress._open_bars))
            raise TestbedError("far enough")

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(import_module(f"testbed.{module}"), function, ended)
            quick = " --set simulation.step=1e-3" if words.startswith("run") else ""
            done = command_line(*shlex.split(words + quick), cwd=home)
        assert done.returncode == 2, words
        assert set(shown) == {True}, long


def test_what_is_missing_or_old_is_said_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only of what is not fine; what only some need is marked apart, developers' is not asked."""
    asked = ["numpy>=99", "not-there-at-all", "pytest>=1", "h5py>=99; extra == 'import'"]
    asked += ["ruff>=1; extra == 'dev'"]
    monkeypatch.setattr(starting, "requires", lambda name: asked)
    found = {each.name: each for each in starting.installation_checks()}
    assert "ruff" not in found
    for name, fine, needed, cure in (
        ("numpy", False, True, "pip install 'numpy>=99'"),
        ("not-there-at-all", False, True, "pip install 'not-there-at-all'"),
        ("pytest", True, True, "pip install"),
        ("h5py", False, False, "pip install 'h5py>=99'"),
    ):
        assert (found[name].fine, found[name].needed) == (fine, needed), name
        assert (cure in found[name].line) is not fine, name
        assert found[name].line.startswith("ok" if fine else "MISSING" if needed else "- "), name
