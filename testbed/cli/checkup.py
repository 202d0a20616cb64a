"""What an installation has and lacks, and how to get it."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from testbed.installation import DISTRIBUTION
from testbed.installation import version as own_version

NOT_FOR_USERS = ("dev",)
"""Extras for those who work on the program itself."""


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: Of it.
        found: What is there.
        fine: Whether that will do.
        needed: Whether nothing works without it.
        cure: What to do where it is not fine.
    """

    name: str
    found: str
    fine: bool = True
    needed: bool = False
    cure: str = ""

    @property
    def line(self) -> str:
        """For people."""
        mark = "ok" if self.fine else ("MISSING" if self.needed else "-")
        cure = "" if self.fine or not self.cure else f": {self.cure}"
        return f"{mark:8s}{self.name:22s}{self.found}{cure}"


def checkup() -> list[Check]:
    """Everything that was looked at, what must be there first."""
    return [*_programs(), *_packages(), *_extras(), _kernel(), _viewer(), _folder()]


def _programs() -> Iterator[Check]:
    cores = os.cpu_count() or 1
    yield Check("testbed", f"{own_version()}, in {Path(__file__).parent.parent}")
    yield Check("Python", f"{platform.python_version()}, {sys.executable}")
    yield Check("machine", f"{platform.machine()}, {platform.system()}, {cores} processors")


def _packages() -> Iterator[Check]:
    """Packages that nothing works without."""
    for text in requires(DISTRIBUTION) or ():
        wanted = Requirement(text)
        if wanted.marker is None or wanted.marker.evaluate({"extra": ""}):
            fine, found = _there(wanted)
            cure = f"pip install '{wanted.name}{wanted.specifier}'"
            yield Check(wanted.name, found, fine, True, cure)


def _extras() -> Iterator[Check]:
    """Packages that only some commands need, extra by extra."""
    for extra in metadata(DISTRIBUTION).get_all("Provides-Extra") or ():
        if extra in NOT_FOR_USERS:
            continue
        wanted = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
        own = [
            each
            for each in wanted
            if each.marker is not None
            and each.marker.evaluate({"extra": extra})
            and not each.marker.evaluate({"extra": ""})
        ]
        states = [_there(each) for each in own]
        found = ", ".join(f"{w.name} {s}" for w, (_, s) in zip(own, states, strict=True))
        cure = f"from the project's folder, pip install -e '.[{extra}]'"
        yield Check(f"extra [{extra}]", found, all(fine for fine, _ in states), False, cure)


def _there(wanted: Requirement) -> tuple[bool, str]:
    """Whether a package is there in a version that will do, and which."""
    try:
        found = version(wanted.name)
    except PackageNotFoundError:
        return False, "not installed"
    if wanted.specifier.contains(found, prereleases=True):
        return True, found
    return False, f"{found}, needed is {wanted.specifier}"


def _kernel() -> Check:
    """The compiled kernel's cache."""
    from testbed.kernel.compiler import cache_folder

    folder = cache_folder()
    if folder.is_relative_to(tempfile.gettempdir()):
        cure = "make ~/.cache/testbed writable, and by you alone; else it is compiled every time"
        return Check("compiled kernel", f"kept in {folder}, for now", False, False, cure)
    if any(folder.glob("**/*.nbi")):
        return Check("compiled kernel", f"ready, in {folder}")
    return Check("compiled kernel", f"not yet: the first run or estimate compiles it into {folder}")


def _viewer() -> Check:
    """Rerun's viewer, and a screen for it."""
    from testbed.viewer.show import has_screen, viewer_program

    program = viewer_program()
    if program is None:
        return Check("viewer", "no command 'rerun'", False, False, "pip install rerun-sdk")
    if not has_screen():
        return Check("viewer", f"{program}; no screen here: testbed view with --save or --serve")
    return Check("viewer", program)


def _folder() -> Check:
    """Whether runs can be written here."""
    here = Path.cwd()
    cure = "work in a folder of your own, or give --out"
    return Check("this folder", str(here), os.access(here, os.W_OK), False, cure)
