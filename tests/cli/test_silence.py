"""Whatever may take long is inside what says how far it is."""

from __future__ import annotations

import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testbed.errors import TestbedError
from testbed.recordings.importing.guess import guessed
from testbed.reporting.output import Progress
from tests.helpers.campaigns import campaign_file
from tests.helpers.command import command_line
from tests.helpers.ideal import ideal
from tests.helpers.runs import MODELS, robot

UNITS = (("position", "rad"), ("torque", "N m"))
MODEL = ("--model", "puma562.xml")
LONG: dict[str, tuple[tuple[str, ...], str]] = {
    "run, the simulation": (("run", "one.toml"), "experiment.simulate:simulate"),
    "run, estimates": (("run", "one.toml"), "experiment.evaluate:evaluate"),
    "run, another motion": (("run", "one.toml"), "experiment.carry_out:checked_elsewhere"),
    "simulate": (("simulate", "one.toml", "--out", "x.parquet"), "experiment.simulate:simulate"),
    "compare": (("compare", "faults"), "experiment.comparison:compare"),
    "excite": (("excite", "puma562.xml"), "experiment.excite:excite"),
    "excite, a proof": (
        ("excite", "one.toml", "--check"), "experiment.motions:checked_motion",
    ),
    "import": (("import", "map.toml", "--out", "x.parquet"), "recordings.importing.pieces:pieces"),
    "import, the check": (
        ("import", "map.toml", "--out", "x.parquet", *MODEL), "sanity.accept:accepted_import",
    ),
    "a guess": (("import", "--guess", "log.csv"), "recordings.importing.guess:guessed"),
    "identify": (("identify", "made.parquet", *MODEL), "identification.identify:identify"),
    "identify, the check": (("identify", "map.toml", *MODEL), "sanity.accept:accept"),
    "identify, bodies": (
        ("identify", "made.parquet", *MODEL, "--consistent"),
        "identification.prior_choice:consistent_by_held_out",
    ),
    "calibrate": (
        ("calibrate", "made.parquet", *MODEL, "--known", "mass=20"),
        "identification.calibration:calibrate",
    ),
    "drives": (("drives", "made.parquet", *MODEL), "identification.identify:identify"),
    "payload": (
        ("payload", "made.parquet", "made.parquet", *MODEL), "identification.identify:identify",
    ),
    "payload at rest": (
        ("payload", "made.parquet", "made.parquet", *MODEL, "--at-rest"),
        "identification.rest:poses_at_rest",
    ),
    "report": (("report", "made.parquet", *MODEL), "experiment.run:assemble_run"),
    "report, drawn": (("report", "made.parquet", *MODEL), "reporting.html:write_report"),
    "view": (("view", "made.parquet", *MODEL, "--save", "x.rrd"), "experiment.growth:growth"),
    "view, written": (("view", "made.parquet", *MODEL, "--save", "x.rrd"), "viewer.log:write_rrd"),
    "campaign": (("campaign", "quick.toml", "--workers", "0"), "campaign.conduct:conduct"),
    "equations": (("equations", "puma562.xml"), "symbolic.equations:equations"),
    "minimal": (("minimal", "puma562.xml"), "parameters.minimal_set:minimal_set"),
    "new": (("new", "puma562.xml"), "experiment.new_experiment:new_experiment"),
    "warmup": (("warmup",), "kernel.numba_engine:warm_up"),
}  # fmt: skip
"""What takes long, of which command."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(MODELS["puma"], folder / "puma562.xml")
    (folder / "one.toml").write_text(
        'name = "one"\nmodel = "puma562.xml"\n[motion]\nduration = 2\ncandidates = 2\n'
    )
    campaign_file(folder, 1)
    recording = ideal(robot("puma"), duration=4)
    recording.save(folder / "made.parquet")
    foreign(folder)
    return folder


def foreign(folder: Path) -> None:
    """The recording in another program's file, and its mapping."""
    recording = ideal(robot("puma"), duration=4)
    names = [f"{kind}_{name} ({unit})" for kind, unit in UNITS for name in recording.names]
    table = np.hstack([recording.measured(kind) for kind, _ in UNITS])
    lines = [",".join(map(repr, row)) for row in np.column_stack([recording.time, table]).tolist()]
    (folder / "log.csv").write_text("\n".join([",".join(["t (s)", *names]), *lines]) + "\n")
    (folder / "map.toml").write_text(guessed([folder / "log.csv"], folder, recording.names).text)


@pytest.mark.parametrize("name", LONG)
def test_nothing_long_is_silent(
    name: str, place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is long ends at once here, and leaves word whether its progress was shown."""
    words, long = LONG[name]
    module, _, function = long.partition(":")
    shown: list[bool] = []

    def ended(*_: Any, **__: Any) -> Any:
        shown.append(bool(Progress._shown))
        raise TestbedError("far enough")

    home = tmp_path / "home"
    shutil.copytree(place, home)
    monkeypatch.setattr(import_module(f"testbed.{module}"), function, ended)
    done = command_line(*words, cwd=home)
    assert shown, done.stderr
    assert all(shown)
    assert done.returncode == 2
    assert not Progress._shown
