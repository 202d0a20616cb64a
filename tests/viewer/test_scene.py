"""What is computed to be shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from testbed.experiment.run import Run
from testbed.identification.estimate import METHODS
from testbed.viewer.scene import Scene, means, plain, pressure, rounded_up, scene_of
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, noisy, robot, run_of

pytestmark = pytest.mark.slow


def test_the_centre_of_pressure_balances_the_moments() -> None:
    rng = np.random.default_rng(0)
    force, point = rng.normal(size=(20, 3)), rng.normal(size=(20, 2))
    force[:, 2] += 5
    arm = np.column_stack([point, np.zeros(20)])
    wrench = np.column_stack([force, np.cross(arm, force)])
    np.testing.assert_allclose(pressure(wrench), point, atol=1e-12)
    assert np.isnan(pressure(np.array([[1.0, 0, 0, 0, 0, 0]]))).all()
    assert np.isnan(pressure(np.array([[0, 0, -9.0, 1, 1, 0]]))).all()  # pulled, not pressed


@pytest.mark.parametrize("samples", [1, 5, 12, 13])
def test_means_of_blocks_keep_every_sample(samples: int) -> None:
    signal = np.random.default_rng(0).normal(size=(samples, 2))
    found = means(signal, 5)
    expected = [signal[k : k + 5].mean(axis=0) for k in range(0, samples, 5)]
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize(("duration", "length"), [(30.0, 10.0), (4.0, 4.0)])
def test_the_first_look_is_at_where_the_clock_begins(duration: float, length: float) -> None:
    """The viewer opens at the first instant of all: a line there is within every plot."""
    tree = robot("puma")
    scene = scene_of(run_of(tree, noisy(ideal(tree, duration=duration))))
    start, end = scene.window
    assert start == scene.run.recording.time[0] <= scene.motion.t[0]
    assert end - start == pytest.approx(length, abs=0.01)


@pytest.mark.parametrize("end", [1e-6, 0.11, 0.15, 0.99, 1.0, 1.01, 7.0, 8.1, 123.0])
def test_axes_end_at_round_numbers(end: float) -> None:
    found = rounded_up(end)
    assert end <= found * (1 + 1e-9) < 1.51 * end
    assert float(f"{found:.1e}") == pytest.approx(found)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_parameter_belongs_to_its_body(name: str) -> None:
    """The formulas of a body's parameters speak of that body first."""
    run = run_of(robot(name))
    scene = scene_of(run)
    for method in METHODS:
        estimate, n = run.estimates[method], run.tree.n
        for body, members in scene.bodies(method).items():
            for k in members:
                touched = {int(c) // 10 for c in np.flatnonzero(estimate.base.matrix[k])}
                if body >= 0:
                    assert body in touched
                for other in touched - {body}:  # what is regrouped comes from further out
                    assert other > body or body < 0
                assert max(touched) < n


def test_the_span_reaches_as_far_as_the_robot(scene: Scene) -> None:
    assert 0.8 < scene.span < 1.8  # a PUMA stretches a metre and a half from its base


def test_poses_are_shown_fifty_times_a_second(scene: Scene) -> None:
    assert scene.frames.step == round(scene.run.recording.rate / 50)


def test_notes_say_what_was_found_and_what_to_be_careful_about(scene: Scene, puma_run: Run) -> None:
    text = scene.notes
    assert text.startswith("# table6")
    assert "**Claim.**" in text
    assert text.count("\n- ") == len(puma_run.warnings)
    assert plain("mb*2z and K*2yy") == r"mb\*2z and K\*2yy"
    odd = replace(puma_run, warnings=("a_b [x](y) `c` <script>",))
    assert r"a\_b \[x\]\(y\) \`c\` \<script\>" in scene_of(odd).notes


def test_what_cannot_be_shown_is_noted(scene: Scene) -> None:
    look = replace(scene.appearance, warnings=("mesh 'arm.stl' is not there",))
    assert r"mesh 'arm\.stl' is not there" in replace(scene, appearance=look).notes
