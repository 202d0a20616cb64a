"""What commands reach besides their files, as the kernel sees it: no network, no other folders."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cli.test_commands import COMMANDS, FAILS, FIRST
from tests.helpers.command import CLI
from tests.helpers.paths import ROOT

STRACE = shutil.which("strace")
pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(STRACE is None, reason="strace is not installed"),
]
CALLS = (
    "trace=connect,bind,sendto,sendmsg,sendmmsg,openat,open,creat,mkdir,mkdirat,rename,renameat,"
    "renameat2"
)
ADDRESS = re.compile(r'sa_family=AF_INET6?,.*?(?:inet_addr\("|inet_pton\(AF_INET6, ")([^"]+)')
OPENED = re.compile(r'(?:open|openat|creat)\((?:AT_FDCWD, )?"([^"]+)", (\S+)')
MADE = re.compile(r'(?:mkdir|mkdirat|rename\w*)\(.*"([^"]+)"[^"]*\) = 0')
LOOPBACK = {"127.0.0.1", "::1"}
CACHED = ("__pycache__", "/dev/", "/proc/self/", "/sys/")


def strays(trace: str, folders: tuple[Path, ...], cwd: Path) -> list[str]:
    """Lines of a trace that reach another machine or write elsewhere than in some folders."""
    found = []
    for line in trace.splitlines():
        if "htons(53)" in line or any(each not in LOOPBACK for each in ADDRESS.findall(line)):
            found.append(line)
        opened, made = OPENED.search(line), MADE.search(line)
        if opened and not re.search("O_WRONLY|O_RDWR|O_CREAT", opened[2]):
            continue
        if opened and " = -1 " in line:
            continue
        for hit in (opened, made):
            path = Path(os.path.normpath(cwd / hit[1])) if hit else None
            kept = path and any(part in str(path) for part in CACHED)
            if path and not kept and not any(map(path.is_relative_to, folders)):
                found.append(line)
    return found


def test_no_command_reaches_the_network_or_writes_where_it_was_not_told(
    place: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In an empty home folder: compiled code and a list of fonts alone are in testbed's cache."""
    room = tmp_path_factory.mktemp("room")
    home, scratch, out = (room / name for name in ("home", "scratch", "out"))
    for folder in (home, scratch, out, home / ".cache"):
        folder.mkdir()
    environment = os.environ | {
        "HOME": str(home), "TMPDIR": str(scratch), "PYTHONPATH": str(ROOT),
    }  # fmt: skip
    environment = {k: v for k, v in environment.items() if not k.startswith("XDG_")}
    pairs = ((FIRST.get(name, name), name) for name in COMMANDS)
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    found: dict[str, list[str]] = {}
    told = scratch, out, home / ".cache/testbed"
    for name in names:
        words = shlex.split(COMMANDS[name][0].replace("OUT", str(out)))
        trace = room / "trace"
        done = subprocess.run(
            [str(STRACE), "-f", "-qq", "-s", "300", "-o", str(trace), "-e", CALLS, *CLI, *words],
            cwd=place, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == (1 if name in FAILS else 0), (name, done.stderr)
        if lines := strays(trace.read_text(errors="replace"), told, place):
            found[name] = lines[:5]
    assert found == {}
