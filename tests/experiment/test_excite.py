"""From an experiment to a motion file that runs, and back."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExperimentError, InfeasibleMotion, TestbedError
from testbed.excitation.design import Design
from testbed.excitation.limit_terms import PlateTerm
from testbed.excitation.proof import prove
from testbed.excitation.rest_to_rest import RestToRest, Start
from testbed.experiment.earlier_estimate import prior_covariance
from testbed.experiment.evaluate import robot_of
from testbed.experiment.excite import Excitation, excite, frequencies_of
from testbed.experiment.motion_file import read_motion
from testbed.experiment.motions import QUIET_PLATE, motion_of, plate_noise_of, rules_of
from testbed.experiment.read_result import KeptResult
from testbed.experiment.trajectory_file import samples_of, write_trajectory
from testbed.experiment.write_motion import write_motion
from testbed.identification.stated import Stated
from testbed.recordings.formats.parquet import open_table
from tests.helpers.paths import GOLDEN
from tests.helpers.runs import MODELS

QUICK = ["excitation.starts=1", "excitation.harmonics=4", "motion.duration=10"]


def asked(name: str = "puma", *settings: str) -> tb.Experiment:
    return tb.Experiment.of_model(MODELS[name], [*QUICK, *settings])


@pytest.fixture(scope="module")
def found() -> Excitation:
    return excite(asked())


@pytest.mark.slow
def test_a_motion_comes_back_from_its_file_as_it_was(found: Excitation, tmp_path: Path) -> None:
    file = tmp_path / "motion.toml"
    write_motion(file, found)
    back = read_motion(file)
    assert back.model == MODELS["puma"].resolve()
    np.testing.assert_array_equal(
        back.motion_for(found.tree).coefficients, found.design.motion.coefficients
    )
    assert back.motion.fundamental == found.design.motion.fundamental


@pytest.mark.slow
def test_an_experiment_runs_a_file_s_motion(found: Excitation, tmp_path: Path) -> None:
    file = tmp_path / "motion.toml"
    write_motion(file, found)
    experiment = asked("puma", f'motion.file="{file}"', "motion.duration=2", "simulation.step=1e-3")
    motion = motion_of(experiment, found.tree)
    recording = tb.simulate(experiment)
    wanted = motion.at(recording.time + 0.5e-3)
    assert np.abs(recording.position - wanted.q).max() < 5e-3


@pytest.mark.slow
def test_a_file_s_motion_is_proven_again(found: Excitation, tmp_path: Path) -> None:
    """Under other limits, and for a robot with other joints."""
    file = tmp_path / "motion.toml"
    write_motion(file, found)
    slower = asked("puma", f'motion.file="{file}"', "motion.max_velocity={waist=0.2}")
    with pytest.raises(InfeasibleMotion, match="velocity of 'waist': exceeded by .* at t = "):
        motion_of(slower, robot_of(slower))
    weak = asked("puma", f'motion.file="{file}"', "measurement.full_scale=[5,5,5,5,5,5]")
    with pytest.raises(InfeasibleMotion, match="does not suit this experiment: .*plate"):
        motion_of(weak, robot_of(weak))
    coarse = asked("puma", f'motion.file="{file}"', "measurement.rate=5", "simulation.bandwidth=2")
    with pytest.raises(ExperimentError, match="too fast for measurement.rate = 5 Hz"):
        motion_of(coarse, robot_of(coarse))
    other = asked("ur5", f'motion.file="{file}"')
    with pytest.raises(ExperimentError, match="moves waist, shoulder, elbow; the robot has"):
        motion_of(other, robot_of(other))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("fundamental = ", "fundamental = -"), "fundamental"),
        (("\noffset", "\nofffset"), "'offfset'; did you mean 'offset'"),
        (("sine = [", "sine = [0.1, "), "equally many"),
        (("[joint", "joint = ["), "not a readable TOML file"),
        (("cosine = [", 'cosine = ["x", '), "cosine"),
    ],
)
def test_files_that_are_no_motion_are_refused(
    found: Excitation, tmp_path: Path, change: tuple[str, str], says: str
) -> None:
    file = tmp_path / "motion.toml"
    write_motion(file, found)
    file.write_text(file.read_text().replace(*change, 1))
    with pytest.raises(ExperimentError, match=says):
        read_motion(file)


@pytest.mark.slow
def test_a_design_beats_the_random_motion_that_would_have_run(found: Excitation) -> None:
    assert found.gain is not None
    assert found.gain > 1.2
    assert isinstance(found.design, Design)
    assert found.design.proof.holds
    assert set(found.predicted.names) == set(tb.minimal_set(found.tree, "reaction").names)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [(0.5, 0.1), (2.5, 0.5)])
def test_sigma_is_as_promised(
    found: Excitation, noise: tuple[float, float], tmp_path: Path
) -> None:
    """Predicted before anything has run; stated by the estimate of a simulated run.

    A few parameters are told by a constant load alone, such as mb*1x of an upright first axis.
    How well, the data decide: they are known less where the plate's zero has to be averaged.
    """
    file = tmp_path / "motion.toml"
    write_motion(file, found)
    plate = [f"measurement.force_noise={noise[0]}", f"measurement.moment_noise={noise[1]}"]
    settings = [*plate, f'motion.file="{file}"', "motion.duration=20", "simulation.friction=false"]
    experiment = asked("puma", "excitation.starts=1", *settings)
    again = excite(asked("puma", *plate, "motion.duration=20"))
    np.testing.assert_allclose(again.design.motion.sine, found.design.motion.sine, atol=1e-6)
    estimate = tb.identify(found.tree, tb.simulate(experiment), "external")
    ratio = estimate.sigma / again.predicted.sigma
    assert ratio.min() > 0.85
    assert np.quantile(ratio, 0.75) == pytest.approx(1, abs=0.1)


@pytest.mark.slow
def test_random_motions_of_experiments_are_proven() -> None:
    for name in ("puma", "gantry"):
        experiment = asked(name, "motion.candidates=3")
        tree = robot_of(experiment)
        motion = motion_of(experiment, tree)
        assert prove(motion, rules_of(experiment, tree, designed=False)).holds


@pytest.mark.slow
def test_random_motions_keep_clear_of_a_box() -> None:
    """Where the best candidate would hit it, another one is run, or a smaller one."""
    free = asked("puma", "motion.candidates=5")
    tree = robot_of(free)
    q = motion_of(free, tree).at(np.linspace(0, 10, 200)).q
    box = "excitation.obstacle=[{centre=[0.5, 0.0, 1.0], size=[0.3, 0.3, 0.3]}]"
    boxed = asked("puma", "motion.candidates=5", box)
    motion = motion_of(boxed, tree)
    rules = rules_of(boxed, tree, designed=False)
    assert prove(motion, rules).holds
    assert not prove(motion_of(free, tree), rules).holds
    assert q.shape == (200, 3)
    everywhere = "excitation.obstacle=[{centre=[0.0, 0.0, 1.0], size=[4.0, 4.0, 4.0]}]"
    with pytest.raises(InfeasibleMotion, match=r'excitation.clearance = "off"'):
        motion_of(asked("puma", "motion.candidates=2", everywhere), tree)


def test_obstacles_need_shapes_that_keep_clear() -> None:
    box = "excitation.obstacle=[{centre=[0.5, 0.0, 1.0], size=[0.3, 0.3, 0.3]}]"
    bare = asked("gantry", box)
    with pytest.raises(ExperimentError, match="has no shapes"):
        motion_of(bare, robot_of(bare))


def test_frequencies_are_within_the_band() -> None:
    for low, high, most in ((0.1, 1.6, 8), (0.2, 1.0, 5), (0.05, 0.5, 3)):
        settings = [
            f"excitation.lowest_frequency={low}",
            f"excitation.highest_frequency={high}",
            f"excitation.harmonics={most}",
            "motion.duration=40",
        ]
        found = frequencies_of(tb.Experiment.of_model(MODELS["puma"], settings))
        for fundamental, harmonics in found:
            assert low <= fundamental
            assert fundamental * harmonics <= high * (1 + 1e-9)
            assert 3 <= harmonics <= most
    with pytest.raises(ExperimentError, match="highest_frequency"):
        frequencies_of(asked("puma", "excitation.highest_frequency=0.2"))


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_samples_for_a_controller_lead_from_rest_to_rest(
    found: Excitation, tmp_path: Path, ending: str
) -> None:
    file = tmp_path / f"samples{ending}"
    start = write_trajectory(file, found, 500.0).start
    if ending == ".csv":
        with file.open(newline="") as opened:
            head, *rows = csv.reader(opened)
        values = dict(zip(head, np.array(rows, dtype=float).T, strict=True))
    else:
        table = open_table(file)
        values = table.read(table.columns, 0, table.samples)
    time = values["time"]
    np.testing.assert_allclose(np.diff(time), 1 / 500, atol=1e-12)
    assert time[0] == pytest.approx(-start.duration)
    assert time[-1] == pytest.approx(10 + start.duration)
    for j, name in enumerate(found.tree.names):
        q, qd, qdd = (values[f"{kind}/{name}"] for kind in ("position", "velocity", "acceleration"))
        for ends in (qd, qdd):
            assert abs(ends[0]) < 1e-9
            assert abs(ends[-1]) < 1e-9
        np.testing.assert_allclose(np.gradient(q, time)[1:-1], qd[1:-1], atol=2e-4)
        np.testing.assert_allclose(np.gradient(qd, time)[1:-1], qdd[1:-1], atol=5e-3)
        inside = (time >= 0) & (time <= 10)
        wanted = found.design.motion.at(time[inside])
        np.testing.assert_allclose(q[inside], wanted.q[:, j], atol=1e-12)


@pytest.mark.slow
def test_samples_are_of_whole_periods(found: Excitation, tmp_path: Path) -> None:
    samples = samples_of(RestToRest(Start(found.design.motion, 1.0), 3), 100.0)
    assert samples.t[0] == -1.0
    assert samples.t[-1] == pytest.approx(3 * found.design.motion.period + 1)
    with pytest.raises(ExperimentError, match="as .csv or .parquet"):
        write_trajectory(tmp_path / "samples.txt", found, 100.0)
    with pytest.raises(ExperimentError, match="lower --rate"):
        write_trajectory(tmp_path / "samples.csv", found, 1e7)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_an_earlier_estimate_is_a_prior(found: Excitation) -> None:
    names = tb.minimal_set(found.tree, "reaction").names
    rng = np.random.default_rng(0)
    root = rng.normal(size=(len(names), len(names)))
    covariance, order = root @ root.T, rng.permutation(len(names))
    stated = Stated(
        method="external",
        names=tuple(names[k] for k in order),
        values=np.zeros(len(names)),
        covariance=covariance[np.ix_(order, order)],
        gravity=np.array([0, 0, -9.81]),
        residual=np.ones(6),
        nuisances={},
    )
    kept = KeptResult(found.tree, tb.Settings(), (stated,))
    np.testing.assert_array_equal(prior_covariance(kept, asked()), covariance)
    with pytest.raises(TestbedError, match="no internal estimate"):
        prior_covariance(kept, asked("puma", "excitation.instrument=joints"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [GOLDEN / "robots/kuka_lwr4.urdf", MODELS["ur5"], MODELS["gantry"]]
)
def test_other_robots_are_excited_too(model: Path) -> None:
    experiment = tb.Experiment.of_model(model, [*QUICK, "excitation.seconds=60"])
    found = excite(experiment)
    assert found.design.proof.holds
    assert np.isfinite(found.predicted.sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_run_from_rest_to_rest_is_recorded_whole_and_counts_in_its_middle(name: str) -> None:
    """Against the same experiment under way, whose periodic part is the same motion."""
    settings = ["motion.fundamental=0.5", "motion.duration=4.9", "simulation.friction=false"]
    settings += ["measurement.rate=1000", "simulation.step=1e-3", "motion.candidates=2"]
    resting = tb.Experiment.of_model(MODELS[name], [*settings, "motion.at_rest=true"])
    recording = tb.simulate(resting)
    under_way = tb.simulate(tb.Experiment.of_model(MODELS[name], settings))
    step = 1 / recording.rate
    lead = -recording.time[0]
    assert lead > 0
    assert recording.time[-1] == pytest.approx(4.0 + lead - step)  # two periods come nearest
    assert recording.facts["counted"] == [0.0, 4.0]
    speed = np.abs(np.gradient(recording.position, step, axis=0)).max(axis=1)
    assert max(speed[:20].max(), speed[-20:].max()) < 5e-3 * speed.max()
    inner = recording.time >= 1.0
    inner &= recording.time < 4.0
    same = np.searchsorted(under_way.time, recording.time[inner] - step / 2)
    swing = np.ptp(under_way.position, axis=0)
    gap = np.abs(recording.position[inner] - under_way.position[same]).max(axis=0)
    assert (gap < 1e-3 * swing).all()
    found = tb.identify(robot_of(resting), recording)
    alone = tb.identify(
        robot_of(resting),
        recording.part(*np.searchsorted(recording.time, [-step / 2, 4 - step / 2])),
    )
    assert (np.abs(found.values - alone.values) < 1e-3 * alone.sigma).all()


@pytest.mark.slow
def test_what_a_motion_hardly_tells_is_said(found: Excitation) -> None:
    relative = found.predicted.relative.copy()
    assert found.warnings == ()
    assert f"{found.gain:.2f} times smaller" in found.beside_random
    blind = replace(found.predicted, relative=relative * np.inf)
    assert replace(found, random_predicted=blind).gain is None
    assert "does not tell all" in replace(found, random_predicted=blind).beside_random
    assert "no random motion" in replace(found, random_predicted=None).beside_random
    poor = replace(found, predicted=replace(found.predicted, relative=relative * 1e4))
    (line,) = poor.warnings
    assert f"hardly tells {', '.join(found.predicted.names[:3])} and " in line


@pytest.mark.slow
def test_a_file_keeps_the_limits_that_were_kept_to(found: Excitation, tmp_path: Path) -> None:
    file = tmp_path / "motion.toml"
    write_motion(file, found)
    limits = tomllib.loads(file.read_text())["limits"]
    assert list(limits) == list(found.tree.names)
    for j, table in enumerate(limits.values()):
        kept = found.rules.limits
        assert table["position"] == [kept.low[j], kept.high[j]]
        assert table["velocity"] == kept.velocity[j]
        assert table["acceleration"] == kept.acceleration[j]
        assert table.get("effort", np.inf) == kept.effort[j]


def test_an_area_of_the_pressure_is_kept_without_ranges_of_the_plate() -> None:
    experiment = asked("puma", "excitation.pressure_area=[0.3, 0.2]", "excitation.clearance=off")
    terms = rules_of(experiment, robot_of(experiment), designed=False).terms
    (plate,) = (term for term in terms if isinstance(term, PlateTerm))
    assert {label[:-1] for label in plate.labels} == {"centre of pressure along "}


def test_a_motion_is_chosen_for_a_quiet_plate_where_it_has_no_noise() -> None:
    words = ("measurement.force_noise=2.0", "measurement.moment_noise=0.3")
    assert plate_noise_of(asked("puma", *words)).tolist() == [2.0] * 3 + [0.3] * 3
    none = plate_noise_of(asked("puma", "measurement.force_noise=0.0"))
    np.testing.assert_array_equal(none, QUIET_PLATE)
