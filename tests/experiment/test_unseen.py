"""A run is validated on a motion that its estimates have not seen, made by the same instrument."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.fourier import Fourier
from testbed.experiment import unseen as module
from testbed.experiment.evaluate import robot_of
from testbed.experiment.motions import another_motion, motion_of
from testbed.experiment.results import result
from testbed.experiment.run import Run
from testbed.experiment.summary import summary
from testbed.experiment.unseen import on_unseen_motion, unseen, validated
from testbed.identification.validate import validate
from tests.helpers.ideal import ideal, plus
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.runs import MODELS, noisy, robot, run_of

DESIGNED = ROOT / "experiments/motions/table6.toml"


def test_a_run_holds_the_validation_of_both_estimates() -> None:
    run = run_of(robot("puma"))
    other = noisy(ideal(run.tree, seed=8), 4)
    done = validated(run, other)
    assert done.warnings == run.warnings
    assert tuple(done.validation) == ("external", "internal")
    for method, found in done.validation.items():
        same = validate(run.tree, other, run.estimates[method], settings=run.settings)
        np.testing.assert_array_equal(found.residual, same.residual)
        assert result(done)["validation"][method]["ratio"] == found.ratio.tolist()
    assert any("Rms residuals on that motion" in line for line in summary(done))
    assert not any("Rms residuals on that motion" in line for line in summary(run))


def test_what_another_motion_shows_is_among_the_runs_warnings() -> None:
    run = run_of(robot("puma"))
    done = validated(run, plus(noisy(ideal(run.tree, seed=8), 4), wrench=[0, 0, 0, 0, 0, 50.0]))
    (new,) = done.findings[len(run.findings) :]
    assert (new.code, new.method, new.subject) == ("prediction", "external", "channel Mz")
    assert new.text in done.warnings


def test_what_cannot_be_simulated_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def impossible(run: Run, progress: object) -> None:
        raise tb.TestbedError("no motion")

    monkeypatch.setattr(module, "unseen", impossible)
    run = run_of(robot("puma"))
    done, other = on_unseen_motion(run)
    assert other is None
    assert done.validation == {}
    assert "no motion" in done.warnings[-1]
    empty = replace(run, estimates={})
    assert on_unseen_motion(empty) == (empty, None)


def gains(recording: tb.Recording) -> Array:
    """Of the plate's channels, (6,)."""
    assert recording.truth is not None
    return np.asarray(np.median(recording.measured("wrench") / recording.truth.wrench, axis=0))


@pytest.mark.slow
def test_the_other_motion_is_measured_by_the_same_instrument(tmp_path: Path) -> None:
    """What chance decides once stays; noise and motion are others."""
    path = tmp_path / "e.toml"
    path.write_text(
        f'name = "e"\nmodel = "{MODELS["ur5"]}"\n[motion]\nduration = 4.0\ncandidates = 1\n'
        "[measurement]\nrate = 200.0\n[[measurement.fault]]\nkind = 'plate_gain'\n"
        "[simulation]\nbandwidth = 30.0\nstep = 1e-3\n"
    )
    run = tb.carry_out(tb.Experiment.load(path))
    assert tuple(run.validation) == ("external", "internal")
    other = unseen(run)
    assert other is not None
    assert np.ptp(gains(run.recording)) > 0.005
    np.testing.assert_allclose(gains(other), gains(run.recording), rtol=1e-12)
    assert abs(other.position - run.recording.position).max() > 0.1
    another = tb.simulate(tb.Experiment.load(path, ["seed=1"]))
    assert abs(gains(another) - gains(run.recording)).max() > 0.005


@pytest.mark.parametrize(
    ("fundamental", "asked", "taken"), [(0.1, 60.0, 12.0), (0.05, 60.0, 20.0), (0.1, 5.0, 5.0)]
)
def test_the_other_motion_lasts_a_period_and_no_longer_than_the_first(
    fundamental: float, asked: float, taken: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tb.Experiment] = []

    def kept(experiment: tb.Experiment, progress: object, installed: int, motion: object) -> None:
        assert isinstance(motion, Fourier)
        assert installed == experiment.seed - 1
        seen.append(experiment)

    monkeypatch.setattr(module, "simulate", kept)
    words = [f"motion.duration={asked}", f"motion.fundamental={fundamental}", "seed=7"]
    run = replace(run_of(robot("puma")), experiment=tb.Experiment.of_model(MODELS["puma"], words))
    unseen(run)
    (other,) = seen
    assert other.motion.duration == taken
    assert other.motion.fundamental == fundamental
    assert other.seed == 8


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("puma", []),
        ("puma", [f'motion.file="{DESIGNED}"']),
        ("ur5", ["excitation.clearance=0.02"]),
        ("gantry", ["seed=3"]),
        ("kuka", []),
    ],
)
def test_the_other_motion_is_about_as_fast_in_every_joint(name: str, words: list[str]) -> None:
    """Or estimates would be held against gravity alone, and friction against a crawl."""
    words = ["motion.candidates=5", *words]
    kuka = {"kuka": GOLDEN / "robots/kuka_lwr4.urdf"}
    experiment = tb.Experiment.of_model((MODELS | kuka)[name], words)
    tree = robot_of(experiment)
    first, other = motion_of(experiment, tree), another_motion(experiment, tree)
    times = np.linspace(0, first.period, 500, endpoint=False)
    for order in (1, 2):
        ours, theirs = (
            np.sqrt(np.mean(motion.derivative(times, order) ** 2, axis=0))
            for motion in (other, first)
        )
        np.testing.assert_array_less(0.49 * theirs, ours)
        np.testing.assert_array_less(ours, 1.01 * theirs)
    apart = other.derivative(times, 0) - first.derivative(times, 0)
    swing = np.ptp(first.derivative(times, 0), axis=0)
    assert (np.abs(apart).max(axis=0) > 0.2 * swing).all()


def test_a_run_of_no_experiment_has_no_other_motion() -> None:
    assert unseen(replace(run_of(robot("puma")), experiment=None)) is None


def test_another_robots_motion_validates_nothing_and_says_so() -> None:
    run = run_of(robot("puma"))
    done = validated(run, ideal(robot("gantry")))
    assert done.validation == {}
    (new,) = (line for line in done.warnings if line not in run.warnings)
    assert new.startswith("not validated on another motion: ")
    assert done.estimates == run.estimates
