"""A drive that believes in a wrong robot: possible bodies, another motion, the same truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.simulation.drive_model import believed
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

MODELS = (ROOT / "models/puma562.xml", *(GOLDEN / f"robots/{n}.urdf" for n in ("ur5", "stanford")))


def trees() -> list[tb.Tree]:
    made = [random_robot(np.random.default_rng(s), 6).tree() for s in range(4)]
    return [*map(tb.load_tree, MODELS), *made]


@pytest.mark.parametrize("tree", trees(), ids=lambda tree: tree.name)
def test_every_body_is_as_wrong_as_said_and_has_its_shape(tree: tb.Tree) -> None:
    wrong = believed(tree, 0.1, np.random.default_rng(0))
    factors = []
    for old, new in zip(tree.inertias, wrong.inertias, strict=True):
        factor = new.mass / old.mass
        factors.append(round(factor, 12))
        np.testing.assert_allclose(new.com, old.com, atol=1e-15)
        np.testing.assert_allclose(new.central, factor * old.central, rtol=1e-9, atol=1e-15)
    assert set(factors) <= {0.9, 1.1}
    for joint, other in zip(tree.joints, wrong.joints, strict=True):
        for name in ("coulomb", "viscous", "rotor_inertia"):
            kept, found = getattr(joint, name), getattr(other, name)
            assert found in (pytest.approx(0.9 * kept), pytest.approx(1.1 * kept))
        assert (other.name, other.parent, other.max_effort) == (
            joint.name,
            joint.parent,
            joint.max_effort,
        )
    np.testing.assert_array_equal(wrong.gravity, tree.gravity)


def test_chance_decides_the_signs_and_no_error_is_none() -> None:
    tree = tb.load_tree(MODELS[1])
    signs = set()
    for seed in range(20):
        wrong = believed(tree, 0.1, np.random.default_rng(seed))
        signs.add(
            tuple(
                new.mass > old.mass for new, old in zip(wrong.inertias, tree.inertias, strict=True)
            )
        )
    assert len(signs) > 10
    same = believed(tree, 0.0, np.random.default_rng(0))
    assert [body.mass for body in same.inertias] == [body.mass for body in tree.inertias]


@pytest.mark.parametrize("model", MODELS[:2], ids=lambda path: path.stem)
def test_the_motion_is_followed_worse_and_the_laws_of_motion_still_hold(model: Path) -> None:
    """Witness of the truth: Newton and Euler with the right masses along the true motion."""
    settings = ["motion.duration=1", "motion.candidates=1", "measurement.averaged=false"]
    settings += ["motion.fundamental=0.5", "simulation.warm_up=0.5"]
    settings += ["simulation.friction=false"]  # its reversals are most of the distance otherwise
    runs = {}
    for error in (0.0, 0.1):
        experiment = tb.Experiment.load(
            ROOT / "experiments/noise_free.toml",
            [*settings, f"simulation.drive_model_error={error}"],
        )
        runs[error] = tb.simulate(experiment.model_copy(update={"model": str(model)}))
    tracking = {e: max(run.facts["tracking_rms"].values()) for e, run in runs.items()}
    assert tracking[0.1] > 20 * tracking[0.0]
    tree, truth, tare = tb.load_tree(model), runs[0.1].truth, runs[0.1].tare
    assert truth is not None
    assert tare is not None
    motion = tb.Motion(runs[0.1].time, truth.position, truth.velocity, truth.acceleration)
    wrench = tb.base_wrench(tree, motion) + tare
    np.testing.assert_allclose(wrench, truth.wrench, atol=1e-9 * np.abs(wrench).max())
    assert np.abs(truth.position - runs[0.0].truth.position).max() > 1e-5  # type: ignore[union-attr]


@pytest.mark.parametrize("error", ["-0.1", "1.0", "nan"])
def test_an_error_that_makes_no_robot_is_refused(error: str) -> None:
    with pytest.raises(tb.TestbedError, match="simulation.drive_model_error"):
        tb.Experiment.load(
            ROOT / "experiments/table6.toml", [f"simulation.drive_model_error={error}"]
        )
