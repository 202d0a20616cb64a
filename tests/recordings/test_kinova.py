"""A real Kinova Gen3: from its logs to a validated estimate.

Witnesses: the arm's other motion, and its gravity: sensors and currents measure one arm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.bodies.posterior import Posterior, posterior, rows_of
from testbed.bodies.prediction_errors import errors_of_another
from testbed.bodies.prior import prior_of
from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.recording import Recording
from testbed.importing.convert import pieces
from testbed.importing.guess import guessed
from tests.helpers.paths import ROOT

GEN3 = ROOT / "examples/kinova_gen3"
TREE = tb.load_tree(GEN3 / "gen3.urdf")
SENSORS: dict[str, object] = {"unit": "N m"}
CURRENTS: dict[str, object] = {
    "columns": [f"Cur{k}" for k in range(1, 8)], "unit": "A", "gain": [9.13] * 4 + [5.852] * 3
}  # fmt: skip
"""All that a person writes of the torques; 9.13 and 5.852 N m/A are the authors'."""


def recordings(folder: Path, torque: dict[str, object]) -> list[Recording]:
    """Both motions, as `import --guess` takes them."""
    found = []
    for motion in (1, 2):
        draft = guessed([GEN3 / f"motion_{motion}.csv.gz"], folder, TREE.names)
        for key, value in torque.items():
            draft = draft.saying("torque", key, value)
        path = folder / f"{motion}.toml"
        path.write_text(draft.saying("position", "unit", "rad").text)
        found.append(pieces(path)[0][0])
    return found


def added(recording: Recording) -> Posterior:
    rows = rows_of(Problem.of(TREE, recording, "internal"), None)
    return posterior(rows, prior_of(TREE))


def left(found: Posterior, unseen: Recording) -> dict[str, Array]:
    """Rms errors of the prediction of another motion, by what predicts."""
    laws = dict.fromkeys(name.split("/")[0] for name in found.names[found.count :])
    settings = tb.Settings(terms=[*laws])
    problem = Problem.of(TREE, unseen, "internal", settings)
    return dict(errors_of_another(problem, problem.source, found.models).residual)


@pytest.mark.parametrize(
    ("torque", "better"), [(SENSORS, 0.35), (CURRENTS, 0.85)], ids=["sensors", "currents"]
)
def test_each_motion_foretells_the_other_better_than_the_file(
    tmp_path: Path, torque: dict[str, object], better: float
) -> None:
    """Over all joints, also than the file with its friction fitted."""
    first, second = recordings(tmp_path, torque)
    assert first.temperature is not None
    assert 29 < first.temperature.min() < first.temperature.max() < 40
    for seen, unseen in ((first, second), (second, first)):
        total = {k: np.linalg.norm(e) for k, e in left(added(seen), unseen).items()}
        assert total["posterior"] < better * min(total["file"], total["refitted"])


def test_sensors_and_currents_agree_that_the_file_is_wrong(tmp_path: Path) -> None:
    """Two instruments of one arm: first moments that are nearer to each other than to the file."""
    sensors, currents = (added(recordings(tmp_path, each)[0]) for each in (SENSORS, CURRENTS))
    for name in ("mb*2y", "mb*4y", "mb*6y"):
        at, beside = sensors.names.index(name), currents.names.index(name)
        one, other, file = sensors.values[at], currents.values[beside], sensors.file[at]
        assert sensors.share[at] > 0.9 < currents.share[beside]
        assert abs(one - other) < min(abs(one - file), abs(other - file))
