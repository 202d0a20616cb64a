"""A run to look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.experiment.growth import growth
from testbed.experiment.run import Run
from testbed.viewer.log import write_rrd
from testbed.viewer.scene import Scene, scene_of


@pytest.fixture(scope="session")
def scene(puma_run: Run) -> Scene:
    return scene_of(puma_run, growth(puma_run, [2.0, 4.0]))


@pytest.fixture(scope="session")
def rrd(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rrd") / "puma.rrd"
    write_rrd([scene], path)
    return path
