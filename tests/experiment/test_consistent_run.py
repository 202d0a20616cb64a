"""Consistent bodies in runs: judged by the truth, claimed, reported, drawn."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.kinematics import poses
from testbed.experiment.consistent_run import with_consistent, wrong_prior
from testbed.experiment.experiment_tables import Bound, PriorTable
from testbed.experiment.results import result
from testbed.experiment.run import Run
from testbed.experiment.wrong_prior import wrong_bodies
from testbed.identification.wishes import Wishes
from testbed.reporting.bodies_section import VIEWS
from testbed.reporting.contents import contents
from testbed.reporting.portrait import view
from testbed.robot.inertia import NOTHING, Inertia
from testbed.robot.visuals.ellipsoids import equivalent_ellipsoids
from testbed.robot.visuals.extents import extents
from testbed.robot.visuals.shapes import Shape
from testbed.viewer.robot_drawing import log_bodies
from testbed.viewer.scene import scene_of
from tests.helpers.runs import experiment, robot, run_of


def asked(**more: Any) -> tb.Experiment:
    plain = experiment(expect={"consistent_to_plain": Bound(at_most=1.5)})
    return plain.model_copy(update={"consistent": Wishes(), **more})


@pytest.fixture(scope="module")
def run() -> Run:
    return with_consistent(run_of(robot("puma"), asked=asked()))


def test_a_claim_about_consistent_bodies_is_judged(run: Run) -> None:
    assert run.consistent is not None
    assert run.verdicts == {"consistent_to_plain": True}
    metrics = run.metrics
    ratio = metrics["consistent_rms_relative_error"] / metrics["external_rms_relative_error"]
    assert metrics["consistent_to_plain"] == pytest.approx(ratio)
    assert metrics["prior_rms_relative_error"] > 10 * metrics["consistent_rms_relative_error"]
    assert 1e-6 < metrics["consistent_least_eigenvalue"] < 1
    said = json.loads(json.dumps(result(run)))
    assert set(said["consistent"]["links"]) == {joint.body for joint in run.tree.joints}


def test_without_the_table_there_are_none() -> None:
    plain = run_of(robot("puma"), asked=experiment())
    assert with_consistent(plain) is plain


def test_a_true_prior_is_no_worse_and_what_fails_is_said() -> None:
    right = with_consistent(run_of(robot("gantry"), asked=asked(prior=PriorTable(error=0.0))))
    assert right.metrics["prior_rms_relative_error"] < 1e-9
    assert right.metrics["consistent_to_plain"] < 1
    wishes = Wishes(known={"mass/nobody": 1.0})
    wrong = with_consistent(run_of(robot("gantry"), asked=asked(consistent=wishes)))
    assert wrong.consistent is None
    assert any("no consistent bodies" in line for line in wrong.warnings)
    assert not wrong.as_expected


@pytest.mark.slow
def test_the_report_draws_every_link_three_times(run: Run) -> None:
    section = next(s for s in contents(run)["figures"] if s["id"] == "bodies")
    assert list(section["legend"].values()) == ["model file", "truth", "estimate"]
    for panel in section["panels"]:
        assert panel["svg"].count("<ellipse") == 3 * run.tree.n
        assert not re.search(r"nan|inf", panel["svg"])
    assert [row[0] for row in section["rows"]] == [joint.body for joint in run.tree.joints]


@pytest.mark.slow
def test_an_outline_is_the_ellipsoid_seen_from_there(run: Run) -> None:
    """Radii and turn of the truth's ellipses: the ellipsoid's matrix, projected, y down."""
    section = next(s for s in contents(run)["figures"] if s["id"] == "bodies")
    placed = [(turn[0], at[0]) for turn, at in poses(run.tree, run.recording.position[:1])]
    shapes = equivalent_ellipsoids(run.tree, (0.0, 0.0, 0.0, 1.0))
    for panel, eye in zip(section["panels"], VIEWS.values(), strict=True):
        lines = [part for part in panel["svg"].split("<ellipse")[1:] if "--truth" in part]
        for line, shape in zip(lines, shapes, strict=True):
            rx, ry = (float(re.findall(f'{r}="([^"]*)"', line)[0]) for r in ("rx", "ry"))
            angle = np.deg2rad(float(re.findall(r"rotate\((\S+)", line)[0]))
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            drawn = turn @ np.diag([rx**2, ry**2]) @ turn.T
            seen = np.diag([1, -1]) @ view(np.array(eye))[:2] @ placed[shape.body][0]
            seen = seen @ shape.rotation @ np.diag(shape.size)
            wanted = seen @ seen.T
            if min(rx, ry) > 3:  # thinner ones are rounded
                off = drawn / np.trace(drawn) - wanted / np.trace(wanted)
                assert np.abs(off).max() < 0.03


def test_the_viewer_draws_them_on_the_robot(run: Run) -> None:
    logged: dict[str, Any] = {}

    class Stream:
        """Keeps what is logged."""

        def log(self, entity: str, what: Any, *, static: bool) -> None:
            assert static
            logged[entity] = what

    log_bodies(Stream(), scene_of(run), "world")  # type: ignore[arg-type]
    wanted = {f"world/robot/{k + 1}/body/{w}" for k in range(3) for w in ("prior", "truth")}
    assert wanted < set(logged)
    assert len(logged) == 9


def test_a_wrong_model_file_is_of_the_seed() -> None:
    tree = robot("ur5")
    one, same = (wrong_prior(tree, asked(seed=3)) for _ in range(2))
    other = wrong_prior(tree, asked(seed=4))
    for a, b, c in zip(one.inertias, same.inertias, other.inertias, strict=True):
        np.testing.assert_array_equal(a.tensor, b.tensor)
        assert a.mass != c.mass
        assert np.linalg.eigvalsh(a.pseudo)[0] > 0


def test_bodies_are_wrong_by_as_much_as_is_said() -> None:
    rng = np.random.default_rng(0)
    tree = robot("puma")
    gaps = []
    for _ in range(400):
        wrong = wrong_bodies(tree, 0.1, rng)
        masses = zip(wrong.inertias, tree.inertias, strict=True)
        gaps += [own.mass / true.mass - 1 for own, true in masses]
    assert np.std(gaps) == pytest.approx(0.1, rel=0.1)
    bare = replace(tree, inertias=(NOTHING,) * 3)
    assert wrong_bodies(bare, 0.3, rng).inertias == bare.inertias


def test_an_even_ellipsoid_has_the_bodys_inertia() -> None:
    """By the moments of a solid ellipsoid in a textbook: m (b^2 + c^2) / 5, and so on."""
    half, mass, com = np.array([0.1, 0.2, 0.4]), 3.0, np.array([0.5, -0.2, 0.1])
    moments = mass / 5 * np.array([half[1:] @ half[1:], half[::2] @ half[::2], half[:2] @ half[:2]])
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    body = Inertia.about_centre(mass, com, turn @ np.diag(moments) @ turn.T)
    tree = replace(robot("puma"), inertias=(body, NOTHING, NOTHING))
    (shape,) = equivalent_ellipsoids(tree, (0, 0, 0, 1))
    np.testing.assert_allclose(shape.size, half, atol=1e-9)
    np.testing.assert_allclose(shape.position, com, atol=1e-12)
    np.testing.assert_allclose(np.abs(shape.rotation.T @ turn), np.eye(3), atol=1e-6)
    assert np.linalg.det(shape.rotation) == pytest.approx(1)


def test_boxes_hold_all_shapes_of_a_body() -> None:
    grey = np.ones(4)
    ball = Shape(0, "ellipsoid", np.full(3, 0.1), np.array([1.0, 0, 0]), np.eye(3), grey)
    box = Shape(0, "box", np.array([0.1, 0.2, 0.3]), np.zeros(3), np.eye(3), grey)
    plate = Shape(-1, "box", np.full(3, 9.0), np.zeros(3), np.eye(3), grey)
    found = extents([ball, box, plate], 2)
    np.testing.assert_allclose(found[0], [[-0.1, -0.2, -0.3], [1.1, 0.2, 0.3]])
    assert np.isinf(found[1]).all()
