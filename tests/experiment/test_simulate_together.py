"""Runs side by side: each is, to the bit, what it is alone, whatever happens beside it."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.errors import TestbedError
from testbed.experiment import simulate as module
from testbed.experiment.simulate import simulate_together
from testbed.simulation.rollout import simulate_motions
from tests.helpers.paths import GOLDEN, ROOT

QUICK = (
    "motion.duration=0.3",
    "motion.candidates=1",
    "simulation.warm_up=0.1",
    "excitation.clearance=off",
    "measurement.torque_constant_error={}",
    "identification.zeros=false",
)
MODELS = {
    "puma": ROOT / "models/puma562.xml",
    "ur5": GOLDEN / "robots/ur5.urdf",
    "gantry": GOLDEN / "robots/gantry_ppp_rrr.urdf",
    "tree": GOLDEN / "robots/random_tree_00.urdf",
}


def experiment(name: str, *words: str) -> tb.Experiment:
    model = f"model={MODELS[name]}"
    return tb.Experiment.load(ROOT / "experiments/table6.toml", [*QUICK, model, *words])


def same(one: object, other: tb.Recording) -> None:
    assert isinstance(one, tb.Recording)
    for signal in ("time", "position", "torque", "wrench", "tare"):
        np.testing.assert_array_equal(getattr(one, signal), getattr(other, signal))
    for mine, theirs in zip(vars(one.truth).values(), vars(other.truth).values(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert one.facts == other.facts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "clock"),
    [
        ("puma", "simulation.step=1e-3"),
        ("ur5", "simulation.step=5e-4"),
        ("gantry", "measurement.averaged=false"),
        ("tree", "simulation.step=1e-3"),
    ],
)
def test_a_run_does_not_depend_on_those_beside_it(name: str, clock: str) -> None:
    """Other motions, other friction, other drives, other noise."""
    first = tb.load_tree(MODELS[name]).names[0]
    words: list[list[str]] = [
        ["seed=1"],
        ["seed=2", "measurement.force_noise=3.0"],
        ["seed=3", f'robot.joint."{first}".coulomb=0.7'],
        ["seed=3", "simulation.drive_model_error=0.2"],
        ["seed=4", 'simulation.effect=[{kind="stribeck_friction",coefficient=0.1}]'],
    ]
    every = [experiment(name, clock, *each) for each in words]
    alone = [tb.simulate(each) for each in every]
    for order in ([0, 1, 2, 3, 4], [3, 2, 1]):
        together = simulate_together([every[k] for k in order])
        for k, found in zip(order, together, strict=True):
            same(found, alone[k])


@pytest.mark.slow
def test_what_happens_twice_is_simulated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def counted(tasks, *rest, **more):  # type: ignore[no-untyped-def]
        seen.append(len(tasks))
        return simulate_motions(tasks, *rest, **more)

    monkeypatch.setattr(module, "simulate_motions", counted)
    noises = [experiment("puma", f"measurement.force_noise={x}") for x in (0.1, 1.0, 10.0)]
    others = [experiment("puma", f"seed={k}") for k in (5, 6)]
    found = list(simulate_together([*noises, *others]))
    assert seen == [3]
    assert all(isinstance(each, tb.Recording) for each in found)
    monkeypatch.setattr(module, "MOST_SAMPLES_TOGETHER", 700)
    again = list(simulate_together([*noises, *others]))
    assert seen == [3, 2, 1]
    for one, other in zip(found, again, strict=True):
        assert isinstance(other, tb.Recording)
        same(one, other)


@pytest.mark.slow
def test_a_run_that_fails_fails_alone() -> None:
    fine = [experiment("puma", f"seed={k}") for k in (1, 2)]
    wrong = experiment("puma", "robot.lock.nobody=0.0")
    weak = [f"robot.joint.{name}.max_effort=0.02" for name in ("elbow", "waist")]
    stiff = ["robot.joint.elbow.rotor_inertia=1e-9", "robot.joint.elbow.viscous=1e7"]
    wild, loose = experiment("puma", *weak), experiment("puma", *stiff)
    found = list(simulate_together([fine[0], wrong, wild, loose, fine[1]]))
    assert isinstance(found[1], TestbedError)
    for asked, one in zip(fine, (found[0], found[4]), strict=True):
        same(one, tb.simulate(asked))
    for asked, one in ((wild, found[2]), (loose, found[3])):
        if isinstance(one, tb.Recording):
            same(one, tb.simulate(asked))
        else:
            with pytest.raises(type(one)) as said:
                tb.simulate(asked)
            assert str(said.value) == str(one)
