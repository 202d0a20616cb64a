"""What the command line says when something is wrong: one printable line, or nothing."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.helpers.command import CLI, command_process
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

PUMA = str(ROOT / "models/puma562.xml")
TABLE6 = str(ROOT / "experiments/table6.toml")
OURS = "testbed: "


def one_line(done: subprocess.CompletedProcess[str], code: int = 2) -> str:
    """The only thing said, on standard error."""
    assert done.returncode == code, done.stderr[-2000:]
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(OURS)
    said = line.removeprefix(OURS)
    assert said.isprintable()
    assert 0 < len(said) <= 500
    return said


def main_that(body: str, *words: str) -> subprocess.CompletedProcess[str]:
    """The program, with a command in the place of its own."""
    code = f"from testbed.cli import main\ndef command():\n    {body}\nmain._command = command\n"
    call = [sys.executable, "-c", f"{code}main.main()", *words]
    return subprocess.run(call, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise MemoryError", "not enough memory; ask for less, such as a shorter motion"),
        ("import numpy; numpy.zeros(10**15)", "not enough memory; ask for less"),
        ("f = lambda: f(); f()", "the input is nested too deeply"),
        (r"b'ab\xff'.decode()", "not UTF-8: invalid start byte at byte 2"),
        ("open('/nowhere/file')", "'/nowhere/file': No such file or directory"),
        ("open('/')", "'/': Is a directory"),
        ("raise OSError('a full disk')", "a full disk"),
        ("raise OSError(28, 'No space left on device')", "No space left on device"),
        ("from testbed.errors import ModelError; raise ModelError('a ' * 10**6)", "a a a"),
        (
            r"from testbed.errors import ModelError; raise ModelError('\x1b[2J\u202e')",
            r"\x1b[2J\u202e",
        ),
        (r"from testbed.errors import ModelError; raise ModelError('a\r\nb\x85c')", "a b c"),
    ],
)
def test_whatever_happens_is_one_line_and_exit_code_two(body: str, said: str) -> None:
    assert said in one_line(main_that(body))


def test_a_library_that_cannot_be_loaded_is_one_line() -> None:
    said = one_line(main_that("import nowhere"), 70)
    assert said == "a library cannot be loaded: No module named 'nowhere'"


def test_a_fault_of_the_program_is_no_failed_claim() -> None:
    done = main_that("raise ZeroDivisionError('of ours')")
    assert done.returncode == 70
    assert "ZeroDivisionError: of ours" in done.stderr
    assert done.stderr.splitlines()[-1].startswith("testbed: the above is a fault of the program")


def test_memory_that_is_really_short(tmp_path: Path) -> None:
    """A limit of the operating system, and a motion that would take much more.

    The motion asks for large arrays. Where small objects run short, Python itself may fail.
    """
    code = (
        "import resource, runpy, sys\n"
        "import numpy, testbed.experiment.carry_out, testbed.robot.formats.mjcf\n"
        "numpy.linalg.svd(numpy.ones((300, 300)))  # BLAS takes its memory\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 200_000_000,) * 2)\n"
        "runpy.run_module('testbed.cli', run_name='__main__', alter_sys=False)\n"
    )
    if not Path("/proc/self/statm").exists():
        pytest.skip("memory is told by Linux only")
    words = ["simulate", TABLE6, "--set", "motion.duration=1900", "--out", "r.parquet"]
    call = [sys.executable, "-c", code, *words]
    done = subprocess.run(call, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert "not enough memory" in one_line(done)


ODD = "a\x1b[31m\u202eb\x9bc\u2066\n d"


@pytest.mark.parametrize(
    "words",
    [
        ("minimal", ODD),
        ("run", ODD),
        ("equations", PUMA, "--zero", ODD),
        ("equations", PUMA, "--form", ODD),
        ("equations", PUMA, "--against", ODD),
        ("minimal", PUMA, "--gravity", ODD),
        ("identify", ODD, "--model", PUMA),
        ("report", ODD),
        ("view", ODD),
        (ODD,),
        (f"--{ODD}",),
        ("run", TABLE6, "--set", ODD),
        ("run", TABLE6, "--set", f"{ODD}=1"),
        ("run", TABLE6, "--set", f"name={ODD}"),
        ("minimal", PUMA, "--zero", "x" * 100_000),
        ("minimal", "x" * 100_000),
        ("minimal", "x/" * 2_000),
        ("run", TABLE6, "--set", "motion.duration=" + "9" * 5000),
        ("run", TABLE6, "--set", "x" * 100_000),
        ("run", TABLE6, "--out", "x" * 300),
        ("equations", PUMA, "--out", "x" * 300),
    ],
    ids=range(21),
)
def test_words_of_any_kind_and_length_are_shown_harmlessly(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    one_line(command_process(*words, cwd=tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    call = [*map(os.fsencode, CLI), b"minimal", b"a\xff\xfe.xml"]
    done = subprocess.run(call, capture_output=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == b"testbed: there is no model file 'a\\udcff\\udcfe.xml'\n"


@pytest.mark.parametrize("kind", ["folder", "pipe", "null", "zero", "loop", "empty", "absent"])
@pytest.mark.parametrize(
    "words",
    [
        ("minimal", "IT"),
        ("equations", "IT"),
        ("equations", PUMA, "--against", "IT"),
        ("run", "IT"),
        ("simulate", "IT", "--out", "r.parquet"),
        ("identify", "IT", "--model", PUMA),
        ("identify", TABLE6, "--model", "IT"),
        ("report", "IT"),
        ("report", "IT", "--model", PUMA),
        ("view", "IT", "--save", "x.rrd"),
        ("view", "IT", "--model", PUMA, "--save", "x.rrd"),
    ],
    ids=range(11),
)
def test_what_is_no_file_of_the_right_kind_is_refused(
    kind: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    place = tmp_path / "inputs/it"
    place.parent.mkdir()
    if kind == "folder":
        place.mkdir()
    elif kind == "pipe":
        os.mkfifo(place)
    elif kind == "loop":
        place.symlink_to(place)
    elif kind == "empty":
        place.touch()
    elif kind != "absent":
        place = Path("/dev") / kind
    (tmp_path / "here").mkdir()
    done = command_process(
        *(str(place) if word == "IT" else word for word in words), cwd=tmp_path / "here", seconds=60
    )
    one_line(done)
    assert list((tmp_path / "here").iterdir()) == []


@pytest.mark.parametrize("target", ["/dev/full", "closed", "pipe"])
@pytest.mark.parametrize("words", [("equations", PUMA), ("minimal", PUMA), ("--help",)])
def test_output_that_nobody_takes(target: str, words: tuple[str, ...], tmp_path: Path) -> None:
    command = " ".join(f"'{word}'" for word in (*CLI, *words))
    if target == "pipe":
        script = f"set -o pipefail; {command} | true"
    else:
        script = f"{command} {'>&-' if target == 'closed' else '> /dev/full'}"
    done = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    if target == "/dev/full":
        assert one_line(done) == "No space left on device"
    else:
        assert done.stderr == ""
        assert done.returncode in {"closed": (0,), "pipe": (0, 141)}[target]


def test_messages_that_nobody_takes(tmp_path: Path) -> None:
    for target in ("2>&-", "2> /dev/full", "2>&- >&- <&-"):
        script = f"{' '.join(CLI)} minimal nowhere.xml {target}"
        done = subprocess.run(
            ["bash", "-c", script], capture_output=True, check=False, cwd=tmp_path
        )
        assert (done.returncode, done.stdout, done.stderr) == (2, b"", b"")


def test_a_reader_that_has_gone_is_not_told() -> None:
    done = main_that("raise BrokenPipeError(32, 'Broken pipe')")
    assert (done.returncode, done.stdout, done.stderr) == (141, "", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_words_that_do_not_fit_are_said_to_be_lost_once() -> None:
    """The interpreter would say on its own that its last words found no place."""
    body = "print('word')\n    sys.stdout.flush()"
    code = f"import sys\nfrom testbed.cli import main\ndef command():\n    {body}\n"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", f"{code}main._command = command\nmain.main()"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=ROOT,
        )
    assert (done.returncode, done.stderr) == (2, "testbed: No space left on device\n")


STARTED = (
    "import sys\nfrom testbed.cli.main import main\n"
    "sys.argv[0] = 'testbed'\nprint('here', flush=True)\nmain()\n"
)


def interrupted(seconds: float, *words: str, cwd: Path) -> tuple[int, str]:
    """Exit code and message of a command that is interrupted after a while."""
    process = subprocess.Popen(
        [sys.executable, "-c", STARTED, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "here\n"
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    return process.returncode, said


def interrupts(words: tuple[str, ...], times: int, within: float, folder: Path) -> None:
    """Interrupts at random times, sooner after a command that had ended by then."""
    chance = random.Random(0)
    seen: list[int] = []
    while len(seen) < times or 130 not in seen:
        assert len(seen) < 10 * times
        seconds = chance.uniform(0, within)
        code, said = interrupted(seconds, *words, cwd=folder)
        # or it had come to its end: a claim that fails makes it 1
        assert (code, said) in ((130, "testbed: interrupted\n"), (0, ""), (1, ""))
        within = within if code == 130 else seconds
        seen.append(code)


@pytest.mark.parametrize(
    "words",
    [("equations", PUMA, "--what", "all"), ("minimal", PUMA, "--verify"), ("run", TABLE6)],
)
def test_ctrl_c_is_one_line_at_any_moment(words: tuple[str, ...], tmp_path: Path) -> None:
    interrupts(words, 4, 1.0, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_ctrl_c_often(tmp_path: Path) -> None:
    for words in (("run", TABLE6, "--set", "motion.duration=4"), ("equations", PUMA)):
        interrupts(words, 6, 3.0, tmp_path)


def test_an_import_that_is_interrupted_may_say_anything() -> None:
    """Libraries turn an interrupt into errors of their own."""
    body = "import os, signal\n    try: os.kill(os.getpid(), signal.SIGINT)\n"
    body += "    except KeyboardInterrupt: raise ImportError('numpy failed to import')"
    done = main_that(body)
    assert one_line(done, 130) == "interrupted"


def test_a_second_ctrl_c_ends_at_once() -> None:
    body = "import os, signal\n    try: os.kill(os.getpid(), signal.SIGINT)\n"
    body += "    finally: os.kill(os.getpid(), signal.SIGINT)"
    done = main_that(body)
    assert done.returncode == -signal.SIGINT
    assert done.stderr == ""


def test_an_ignored_ctrl_c_stays_ignored() -> None:
    """As under nohup."""
    body = "import os, signal\n    os.kill(os.getpid(), signal.SIGINT)\n    return 0"
    code = f"trap '' INT; {sys.executable} -c \"$CODE\""
    text = f"from testbed.cli import main\ndef command():\n    {body}\n"
    text += "main._command = command\nmain.main()"
    done = subprocess.run(
        ["bash", "-c", code],
        env=os.environ | {"CODE": text},
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_command_looks_for_no_library_of_windows() -> None:
    """It takes another process to try one; Ctrl-C would be lost in it, or shown by it."""
    code = "import sys\nfrom testbed.cli import main\nsys.argv[1:] = ['minimal', sys.argv[1]]\n"
    code += "try: main.main()\nfinally: print('glfw' in sys.modules, 'mujoco' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code, PUMA],
        capture_output=True,
        text=True,
        check=False,
        env={name: value for name, value in os.environ.items() if name != "MUJOCO_GL"},
    )
    assert done.stdout.splitlines()[-1] == "False True"
