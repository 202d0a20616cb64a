"""Files of a run and of a motion: what was written is what is read, and nothing else passes."""

from __future__ import annotations

import json
import re
import shutil
from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.applications.validate import validate
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.shapes.appearance import load_shapes
from testbed.core.base.codec import json_text
from testbed.core.base.errors import ExperimentError, NoFeasibleMotion, TestbedError
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.rules import SIGNALS
from testbed.core.recordings.metadata import Metadata
from testbed.core.robot.model_file import ModelFile
from testbed.lab.experiment.excite import excite, frequencies_of
from testbed.lab.experiment.motions import experiment_motion, rules_of
from testbed.lab.experiment.read_result import (
    MAX_RESULT_BYTES,
    StoredResult,
    prior_covariance,
    read_result,
)
from testbed.lab.experiment.results import (
    check_folder,
    read_estimates,
    read_run,
    run_result,
    write_estimates,
    write_recording_folder,
    write_run,
)
from testbed.lab.experiment.results import identification_result as identified_result
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.robot_tables import RecordingTables
from testbed.lab.experiment.run import Run
from testbed.motion.excite import Excitation
from testbed.motion.motion_file import read_motion, write_motion, write_trajectory
from testbed.motion.proof import prove
from testbed.motion.terms import PlateTerm
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import MODELS
from tests.scenarios.scenarios import result

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 4 3\nf 1 2 4\nf 2 3 4\n"
URDF = """<robot name="one"><link name="base"/><link name="arm">
<inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.15"/></inertial>
<visual><geometry><mesh filename="package://maker/shapes/cube.obj"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="100" velocity="2"/></joint></robot>"""
MJCF = """<mujoco model="one"><compiler meshdir="../shapes"/>
<asset><mesh name="cube" file="cube.obj"/></asset><worldbody><body name="arm">
<inertial mass="2" pos="0.1 0 0.2" diaginertia="0.1 0.2 0.15"/>
<joint name="j" axis="0 1 0" range="-90 90"/><geom type="mesh" mesh="cube"/></body></worldbody>
</mujoco>"""


def experiment(folder: Path, text: str) -> tb.Experiment:
    """Of a model with a mesh, in folders of their own, beside a file that is nobody's business."""
    model = folder / ("maker/models/one." + ("xml" if text is MJCF else "urdf"))
    model.parent.mkdir(parents=True)
    (folder / "maker/shapes").mkdir()
    (folder / "maker/shapes/cube.obj").write_text(CUBE)
    (folder / "maker/shapes/key.txt").write_text("secret")
    model.write_text(text)
    path = folder / "e.toml"
    path.write_text(
        f'name = "one"\nmodel = "{model.relative_to(folder)}"\n[motion]\nduration = 3.0\n'
        "candidates = 1\n[measurement]\nrate = 200.0\n[simulation]\nbandwidth = 30.0\n"
    )
    return tb.Experiment.from_toml(path)


@pytest.mark.slow
@pytest.mark.parametrize("text", [MJCF, URDF], ids=["mjcf", "urdf"])
def test_a_run_folder_can_be_moved_and_its_model_may_go(text: str, tmp_path: Path) -> None:
    """And carried out again from it, to the bit."""
    asked = experiment(tmp_path / "here", text)
    run = tb.carry_out(asked)
    looks = load_shapes(ModelFile(Path(asked.model)), run.tree)
    write_run(run, tmp_path / "run")
    shutil.rmtree(tmp_path / "here")
    (tmp_path / "run").rename(tmp_path / "there")
    again = read_run(tmp_path / "there")
    assert again.experiment is not None
    for method, estimate in run.estimates.items():
        np.testing.assert_array_equal(again.estimates[method].values, estimate.values)
    found = load_shapes(ModelFile(Path(again.experiment.model)), again.tree)
    assert any(shape.kind == "mesh" for shape in found.shapes)
    for one, other in zip(found.shapes, looks.shapes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    recording = tb.record(tb.Experiment.from_toml(tmp_path / "there/experiment.toml"))
    np.testing.assert_array_equal(recording.measured("wrench"), run.recording.measured("wrench"))


RUNS = ("puma", "ur5", "gantry", "tree_of_30", "free_base", "drives", "import", "bodies")


def said(run: Run) -> str:
    """All that a program reads of a run, and what is not in its file: other products."""
    sums = {m: [each.normal_equations.residual(each.values).tolist(), each.matters, each.names]
            for m, each in run.estimates.items()}  # fmt: skip
    return json.dumps([json_text(run_result(run).document()).decode(), sums, run.settings.terms])


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_all_that_came_of_a_run_comes_back(name: str, tmp_path: Path) -> None:
    """To the bit, of every kind of robot and of whatever was asked; of another source, nothing."""
    run: Run = result(name)
    bare = replace(
        run, estimates={}, failures={}, score=None, validation={}, drives=None,
        consistent=None, diagnostics=(),
    )  # fmt: skip
    paths = tmp_path / "one", tmp_path / "other"
    for path in paths:
        write_estimates(run_result(run, {"of": name}), path)
    assert len({path.read_bytes() for path in paths}) == 1
    back = read_estimates(bare, paths[0], {"of": name})
    assert back is not None
    assert said(back) == said(run)
    assert read_estimates(bare, paths[0], {"of": "another"}) is None
    content = bytearray(paths[0].read_bytes())
    for at in np.random.default_rng(0).integers(0, len(content), 20).tolist():
        content[at] ^= 0x55
        paths[0].write_bytes(content)
        content[at] ^= 0x55
        spoiled = read_estimates(bare, paths[0], {"of": name})
        assert spoiled is None or said(spoiled) == said(run)


@pytest.mark.slow
def test_a_run_folder_is_identified_again_where_it_was_changed(tmp_path: Path) -> None:
    """Else a report is of other settings than the folder says; an older folder has no estimates."""
    run, place = tb.carry_out(experiment(tmp_path / "here", URDF)), tmp_path / "run"
    write_run(run, place)
    whole = read_run(place)
    assert whole.unseen is not None
    assert said(whole) == said(run)
    asked = place / "experiment.toml"
    text = asked.read_text()
    asked.write_text(text.replace("seed = 0", "seed = 0\n"))
    again = read_run(place)
    assert (again.unseen, again.validation) == (None, {})
    for method, estimate in run.estimates.items():
        np.testing.assert_array_equal(again.estimates[method].values, estimate.values)
    wider = f"deadband = {10 * run.settings.deadband}"
    asked.write_text(re.sub(r"deadband = \S+", wider, text))
    assert read_run(place).estimates["torque"].samples < run.estimates["torque"].samples


@pytest.mark.slow
def test_a_run_folder_takes_nothing_else_along(tmp_path: Path) -> None:
    """Without a result, as where the identification was interrupted, it is read all the same."""
    asked, place = experiment(tmp_path / "here", URDF), tmp_path / "run"
    recording = tb.record(asked)
    write_recording_folder(asked, recording, place)
    assert set(read_run(place).estimates) == set(SIGNALS)
    (place / "notes.txt").write_text("mine")
    with refuses(ExperimentError, "notes.txt"):
        check_folder(place, asked, force=True)
    model = Path(asked.model)
    model.write_text(model.read_text().replace("cube.obj", "key.txt"))
    write_recording_folder(asked, recording, tmp_path / "other")
    assert not list((tmp_path / "other").rglob("key.txt"))
    copied = Path(tb.Experiment.from_toml(place / "experiment.toml").model)
    for change in (lambda: copied.write_text(f"{URDF}<!-- changed -->"), copied.unlink):
        change()
        with refuses(ExperimentError, copied.name):
            read_run(place)


# results


SAID = ["identification.zeros=true", "identification.cutoff=6", "robot.lock.waist=0.5"]
HELD = ModelFile(MODELS["puma"], lock={"waist": 0.4, "elbow": None})


@cache
def identified() -> tuple[dict[str, Any], tuple[Estimate, ...]]:
    """What `identify --json` prints of a held PUMA, and the estimates themselves."""
    tree, tables = HELD.tree(), RecordingTables.from_overrides(SAID)
    recording = measured(tree, 1, duration=12)
    found = [tb.identify(tree, recording, m, settings=tables.identification) for m in SIGNALS]
    return json.loads(json_text(identified_result(found, HELD, tables).document())), tuple(found)


PARTS = ("names", "values", "covariance", "residual", "gravity")
NEEDED = [("model", "sha256"), ("settings",)]
NEEDED += [("estimates", m, k) for m in SIGNALS for k in PARTS]
WRONG: list[Any] = [None, "x" * 10_000, "a\0b", -3, 10**400, float("nan"), [[1]], {"no": [1]}]
ODD: list[tuple[tuple[str, ...], Any]] = [
    *product(NEEDED, [KeyError, *WRONG]),
    *product([("model", "path")], ["/", "a\0b"]),
    (("model", "lock"), {"nobody": 0.0}),
    (("estimates", "wrench", "values"), [1.0]),
    (("estimates", "wrench", "residual"), [-1.0] * 6),
    (("estimates", "wrench", "residual"), [1.0] * 7),
    (("estimates", "torque", "residual"), [1.0] * 2),
]


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    """Or nonsense is validated, or a stranger's file ends the program with a stack."""
    content, path, texts = identified()[0], tmp_path / "result.json", list[bytes]()
    ragged = [[1.0], *content["estimates"]["wrench"]["covariance"][1:]]
    for where, wrong in [*ODD, (("estimates", "wrench", "covariance"), ragged)]:
        here = spoiled = deepcopy(content)
        for key in where[:-1]:
            here = here[key]
        here[where[-1]] = wrong
        if wrong is KeyError:
            del here[where[-1]]
        texts.append(json.dumps(spoiled).encode())
    many, large = b'{"wrench": {"names": ' + b"9" * 10_000 + b"}}", b" " * (MAX_RESULT_BYTES + 1)
    texts += [b"", b"\xff\xfe\x00", b"PAR1", b"[" * 100_000, b"[]", b"{}", many, large]
    for text in texts:
        path.write_bytes(text)
        with pytest.raises((TestbedError, OSError)) as error:
            read_result(path)
        assert "\n" not in str(error.value), text[:20]
    path.unlink()
    for nothing in (tmp_path, tmp_path / "nowhere"):
        with refuses(TestbedError, str(nothing)):
            read_result(nothing)


def test_a_result_validates_to_the_same_bits(tmp_path: Path) -> None:
    """The model may have moved, but is the same; settings can be overridden; gears are coupled."""
    (content, estimates), tree, path = identified(), HELD.tree(), tmp_path / "result.json"
    path.write_text(json.dumps(content))
    kept, other = read_result(path), measured(tree, 2, duration=9)
    assert kept.settings == RecordingTables.from_overrides(SAID).identification
    for estimate, said in zip(estimates, kept.estimates, strict=True):
        one, two = (
            validate(own, other, each, settings=kept.settings)
            for own, each in ((tree, estimate), (kept.tree, said))
        )
        np.testing.assert_array_equal(one.ratio, two.ratio)
    changed = read_result(path, settings=["identification.deadband=0.1"]).settings
    assert (changed.deadband, changed.cutoff) == (0.1, 6)
    path.write_text(json.dumps(content | {"model": content["model"] | {"path": "gone.xml"}}))
    assert read_result(path, MODELS["puma"]).tree.n == 1
    for model, culprit in ((None, "--model"), (MODELS["ur5"], "SHA-256")):
        with refuses(TestbedError, culprit):
            read_result(path, model)
    gear = {"gear": {"matrix": [[40, 0, 0], [0, 20, 10], [0, -30, 0]]}}
    puma = ModelFile(MODELS["puma"])
    coupled = measured(puma.tree(), 1, duration=6)
    coupled = replace(coupled, metadata=Metadata(mapping=gear | {"joints": list(coupled.names)}))
    geared = tb.identify(puma.tree(), coupled, "torque")
    document = identified_result([geared], puma, RecordingTables.from_overrides([])).document()
    path.write_bytes(json_text(document))
    assert [shaft.name for shaft in read_result(path).tree.shafts] == ["shoulder.motor"]


# motions


def asked(name: str = "puma", *words: str) -> tb.Experiment:
    quick = ("excitation.starts=1", "excitation.harmonics=4", "motion.duration=10")
    return tb.Experiment.of_model(MODELS[name], [*quick, *words])


@pytest.mark.slow
def test_a_designed_motion_comes_back_from_its_file_and_is_proven_again(tmp_path: Path) -> None:
    """Under other limits, for other joints or at a poor rate it is refused."""
    found: Excitation = result("motion")
    assert found.gain is not None
    assert found.gain > 1.2  # a random motion would have told less
    file = tmp_path / "motion.toml"
    write_motion(file, found, MODELS["puma"])
    back = read_motion(file)
    motion = back.motion_for(found.tree)
    np.testing.assert_array_equal(motion.coefficients, found.design.motion.coefficients)
    assert back.motion.fundamental == found.design.motion.fundamental
    text = file.read_text()
    word, wrist = f'motion.file="{file}"', "sensors.wrist.link=link3"
    tips = "excitation.pressure_area=[0.01,0.01]"
    for name, kind, words, culprit in (
        ("puma", NoFeasibleMotion, ["motion.max_velocity={waist=0.2}"], "velocity of 'waist'"),
        ("puma", NoFeasibleMotion, ["measurement.full_scale=[5,5,5,5,5,5]"], "plate"),
        ("puma", NoFeasibleMotion, [wrist, "sensors.wrist.full_scale=[5,5,5,5,5,5]"], "wrist"),
        ("puma", NoFeasibleMotion, [wrist, "robot.sensor=wrist", tips], "pressure"),
        ("puma", ExperimentError, ["measurement.rate=5", "simulation.bandwidth=2"], "rate"),
        ("ur5", ExperimentError, [], "waist"),
    ):
        other = asked(name, word, *words)
        with pytest.raises(kind, match=culprit):
            experiment_motion(other, robot_of(other))
    run = asked("puma", word, "motion.duration=2", "simulation.step=1e-3")
    recording = tb.record(run)
    wanted = experiment_motion(run, found.tree).at(recording.time + 0.5e-3)
    assert np.abs(recording.position - wanted.q).max() < 5e-3
    for change, culprit in (
        (("fundamental = ", "fundamental = -"), "fundamental"),
        (("\noffset", "\nofffset"), "'offfset'"),
        (("sine = [", "sine = [0.1, "), "sine"),
    ):
        file.write_text(text.replace(*change, 1))
        with pytest.raises(ExperimentError, match=culprit):
            read_motion(file)


def test_a_trajectory_goes_from_rest_to_rest_through_the_motion(tmp_path: Path) -> None:
    """Or a controller that follows the file jerks the robot, or runs another motion."""
    found: Excitation = result("motion")
    start = write_trajectory(tmp_path / "samples.csv", found, 500.0, 10.0).start
    with (tmp_path / "samples.csv").open() as opened:
        head = opened.readline().strip().split(",")
        values = dict(zip(head, np.loadtxt(opened, delimiter=",").T, strict=True))
    time = values["time"]
    assert (time[0], time[-1]) == pytest.approx((-start.duration, 10 + start.duration))
    inside = (time >= 0) & (time <= 10)
    for j, name in enumerate(found.tree.names):
        q, qd, qdd = (values[f"{kind}/{name}"] for kind in ("position", "velocity", "acceleration"))
        assert np.abs([qd[0], qd[-1], qdd[0], qdd[-1]]).max() < 1e-9
        np.testing.assert_allclose(np.gradient(q, time)[1:-1], qd[1:-1], atol=2e-4)
        np.testing.assert_allclose(np.gradient(qd, time)[1:-1], qdd[1:-1], atol=5e-3)
        own = found.design.motion.at(time[inside]).q[:, j]
        np.testing.assert_allclose(q[inside], own, atol=1e-12)
    with refuses(ExperimentError, "1e+07"):
        write_trajectory(tmp_path / "none.csv", found, 1e7, 10.0)
    assert not (tmp_path / "none.csv").exists()


@pytest.mark.slow
def test_sigma_is_as_promised_and_an_earlier_estimate_is_a_prior(tmp_path: Path) -> None:
    """Predicted before anything has run; stated by the estimate of a simulated run.

    A few parameters are told by a constant load alone, such as mb*1x of an upright first axis.
    """
    found: Excitation = result("motion")
    write_motion(tmp_path / "motion.toml", found, MODELS["puma"])
    words = ["motion.duration=20", "measurement.force_noise=0.5", "measurement.moment_noise=0.1"]
    words.append("excitation.lowest_frequency=0.2")  # as two periods in ten seconds ask for
    promised = excite(asked("puma", *words)).predicted.sigma  # of the same motion, for longer
    words += [f'motion.file="{tmp_path / "motion.toml"}"', "simulation.friction=false"]
    estimate = tb.identify(found.tree, tb.record(asked("puma", *words)), "wrench")
    ratio = estimate.sigma / promised
    assert ratio.min() > 0.85
    assert np.quantile(ratio, 0.75) == pytest.approx(1, abs=0.1)
    order = np.random.default_rng(0).permutation(len(ratio))
    names, covariance = np.array(estimate.names)[order], estimate.covariance[np.ix_(order, order)]
    stated = estimate.with_(names=tuple(names), covariance=covariance)
    tree = found.tree
    options = ConsistencyOptions()
    kept = StoredResult(tree, tb.Settings(), tree, options, (stated,))
    np.testing.assert_array_equal(prior_covariance(kept, asked()), estimate.covariance)
    with refuses(TestbedError, "torque"):
        prior_covariance(kept, asked("puma", "excitation.instrument=joints"))


@pytest.mark.slow
def test_random_motions_are_proven_keep_clear_and_frequencies_are_within_the_band() -> None:
    """Where the best candidate would hit a box, another one is run, or a smaller one."""
    free = asked("puma", "motion.candidates=5")
    tree = robot_of(free)
    box = "excitation.obstacle=[{centre=[0.5, 0.0, 1.0], size=[0.3, 0.3, 0.3]}]"
    boxed = asked("puma", "motion.candidates=5", box)
    rules = rules_of(boxed, tree, designed=False)
    assert prove(experiment_motion(boxed, tree), rules).is_valid
    assert not prove(experiment_motion(free, tree), rules).is_valid
    everywhere = "excitation.obstacle=[{centre=[0.0, 0.0, 1.0], size=[4.0, 4.0, 4.0]}]"
    with refuses(NoFeasibleMotion, "excitation.clearance"):
        experiment_motion(asked("puma", "motion.candidates=2", everywhere), tree)
    bare = asked("gantry", box)
    with pytest.raises(ExperimentError):  # no shapes that could keep clear
        experiment_motion(bare, robot_of(bare))
    area = asked("puma", "excitation.pressure_area=[0.3, 0.2]", "excitation.clearance=off")
    (plate,) = (
        t for t in rules_of(area, tree, designed=False).force_limits if isinstance(t, PlateTerm)
    )
    assert {label[:-1] for label in plate.labels} == {"centre of pressure along "}
    for low, high, most in ((0.1, 1.6, 8), (0.05, 0.5, 3)):
        band = f"excitation.lowest_frequency={low}", f"excitation.highest_frequency={high}"
        many = f"excitation.harmonics={most}"
        for fundamental, count in frequencies_of(asked("puma", *band, many, "motion.duration=40")):
            assert low <= fundamental
            assert fundamental * count <= high * (1 + 1e-9)
            assert 3 <= count <= most
    with refuses(ExperimentError, "highest_frequency"):
        frequencies_of(asked("puma", "excitation.highest_frequency=0.2"))


@pytest.mark.slow
def test_a_run_from_rest_to_rest_is_recorded_whole_and_counts_in_its_middle() -> None:
    words = ["motion.fundamental=0.5", "motion.duration=4.9", "simulation.friction=false"]
    words += ["measurement.rate=1000", "simulation.step=1e-3", "motion.candidates=2"]
    resting = tb.Experiment.of_model(MODELS["puma"], [*words, "motion.at_rest=true"])
    recording = tb.record(resting)
    step, lead = 1 / recording.rate, -recording.time[0]
    assert recording.time[-1] == pytest.approx(4.0 + lead - step)  # two periods come nearest
    assert recording.metadata.counted == (0.0, 4.0)
    speed = np.abs(np.gradient(recording.position, step, axis=0)).max(axis=1)
    assert max(speed[:20].max(), speed[-20:].max()) < 5e-3 * speed.max()
    wanted = experiment_motion(resting, robot_of(resting)).at(recording.time + step / 2).q
    inner = (recording.time >= 1.0) & (recording.time < 4.0)
    assert np.abs(recording.position - wanted)[inner].max() < 5e-3
    part = recording.part(*np.searchsorted(recording.time, [-step / 2, 4 - step / 2]))
    found, alone = (tb.identify(robot_of(resting), each) for each in (recording, part))
    assert (np.abs(found.values - alone.values) < 1e-3 * alone.sigma).all()
