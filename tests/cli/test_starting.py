"""The first hour: `doctor` says what is missing; whatever may take long says how far it is."""

from __future__ import annotations

import json
import shlex
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from testbed.cli import starting
from testbed.core.base.errors import TestbedError
from testbed.view.output import Progress
from tests.helpers.command import command_line

PUMA = "one.parquet --model puma562.xml"
LONG = {
    "lab.experiment.record:record": ("simulate table.toml --out x.parquet",),
    "lab.experiment.carry_out:record": ("run table.toml",),
    "lab.experiment.carry_out:evaluate": ("run table.toml --set motion.duration=2",),
    "lab.experiment.new_experiment:new_experiment": ("new two.urdf",),
    "lab.experiment.run:assemble_run": (f"report {PUMA}",),
    "importing.convert:pieces": ("import map.toml --out x.parquet",),
    "importing.guess:guessed": ("import --guess log.csv",),
    "importing.check.check:import_and_check": ("import map.toml --out x.parquet --model two.urdf",),
    "core.estimation.analysis:estimate_of": (f"identify {PUMA}",),
    "applications.drives.identify_drives:identify_drives": (f"drives {PUMA}",),
    "core.estimation.identify:identify": ("payload one.parquet " + PUMA,),
    "core.estimation.analysis:consistent": (f"identify {PUMA} --consistent",),
    "applications.calibration:calibrate": (f"calibrate {PUMA} --known mass=20",),
    "view.viewer.log:write_rrd": (f"view {PUMA} --save x.rrd",),
    "campaigns.conduct:conduct": ("campaign quick.toml --workers 0",),
    "core.kernel.numba_engine:warm_up": ("doctor --compile",),
}  # fmt: skip
"""What may take long, and the commands that do it."""


@pytest.mark.slow
def test_nothing_long_is_silent(place: Path, tmp_path: Path) -> None:
    """What is long ends at once here, and leaves word whether its progress was shown."""
    home = tmp_path / "home"
    shutil.copytree(place, home)
    for long, commands in LONG.items():
        module, _, function = long.partition(":")
        shown: list[bool] = []

        def ended(*_: Any, seen: list[bool] = shown, **__: Any) -> Any:
            seen.append(bool(Progress._shown))
            raise TestbedError("far enough")

        for words in commands:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(import_module(f"testbed.{module}"), function, ended)
                quick = " --set simulation.step=1e-3" if words.startswith("run") else ""
                done = command_line(*shlex.split(words + quick), cwd=home)
            assert done.returncode == 2, words
        assert len(shown) >= len(commands), long
        assert all(shown), long


def test_the_doctor_finds_this_installation_well(tmp_path: Path) -> None:
    done = command_line("doctor", "--json", cwd=tmp_path)
    checks = {each["name"]: each for each in json.loads(done.stdout)["checks"]}
    assert {"testbed", "Python", "mujoco", "pin", "h5py"} <= set(checks)
    assert "ruff" not in checks
    assert all(each["fine"] for each in checks.values() if each["needed"])


def test_what_is_missing_or_old_is_said_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only of what is not fine; what only some need is marked apart."""
    asked = ["numpy>=99", "not-there-at-all", "pytest>=1", "h5py>=99; extra == 'import'"]
    monkeypatch.setattr(starting, "requires", lambda name: asked)
    found = {each.name: each for each in starting.checkup()}
    for name, fine, needed, cure in (
        ("numpy", False, True, "pip install 'numpy>=99'"),
        ("not-there-at-all", False, True, "pip install 'not-there-at-all'"),
        ("pytest", True, True, "pip install"),
        ("h5py", False, False, "pip install 'h5py>=99'"),
    ):
        assert (found[name].fine, found[name].needed) == (fine, needed), name
        assert (cure in found[name].line) is not fine, name
        assert found[name].line.startswith("ok" if fine else "MISSING" if needed else "- "), name
