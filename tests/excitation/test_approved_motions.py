"""Designed motions of three kinds of robots: what they promise, as approved."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.helpers.approved import hold, timeless
from tests.helpers.command import command_line
from tests.helpers.runs import MODELS

pytestmark = pytest.mark.slow

SEARCHED = 0.1
"""Relative difference of sigmas: rounding leads a search, which ends where little is left to be
had, by another way on other processors."""

QUICK = ("excitation.starts=1", "excitation.harmonics=3", "motion.duration=8")
ASKED: dict[str, tuple[str, ...]] = {
    "puma_d": ("excitation.criterion=d", "motion.fundamental=0.25"),
    "puma_e": ("excitation.criterion=e", "motion.max_velocity={elbow=2}"),
    "puma_plate": (
        "excitation.instrument=both",
        "motion.max_acceleration={waist=3}",
        "excitation.plate_range=[80,80,600,90,90,50]",
    ),
    "puma_free": ("excitation.clearance=off", "motion.harmonics=3"),
    "puma_unbolted": ("excitation.pressure_area=[0.6,0.5]", "excitation.obstacle=[]"),
    "puma_floor": ("excitation.clearance=0.05",),
    "gantry": (),
    "ur5": ("excitation.clearance=off",),
}


@pytest.mark.parametrize("name", ASKED)
def test_a_design_is_as_approved(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    words = [word for each in (*QUICK, *ASKED[name]) for word in ("--set", each)]
    model = MODELS[name.partition("_")[0]].name
    shutil.copy(MODELS[name.partition("_")[0]], tmp_path / model)
    done = command_line("excite", model, *words, cwd=tmp_path)
    told, _, limits = done.stdout.partition("limit on")
    last = [
        line for line in limits.splitlines() if "limits" in line
    ]  # what is left is not as sharp
    text = "\n".join([f"$ testbed excite {model} {' '.join(words)}", told, *last, done.stderr])
    text = re.sub(r"(condition number \d+)\b", r"\1.0", text)  # is no count
    hold(f"design_{name}.txt", timeless(text.replace(str(tmp_path), "")), within=SEARCHED)
