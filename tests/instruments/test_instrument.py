"""The whole instrument: perfect unless told otherwise, faults in their places, noise kept.

If one fails, a simulated recording has other noise or faults than its file says.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from docs.instruments import catalogue
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError, TestbedError
from testbed.core.recordings.recording import Recording, Truth
from testbed.lab.instruments.chain import Instrument, measure, measured_again
from testbed.lab.instruments.fault import FULL_SCALE, Fault, Place, apply_chain, stream
from testbed.lab.instruments.faults import KINDS, fault_of
from testbed.lab.instruments.joints import (
    EncoderEccentricity,
    EncoderInstantSampling,
    EncoderNoise,
    EncoderResolution,
    EncoderZeroError,
)
from testbed.lab.instruments.plate import (
    MeasuredTare,
    PlateBias,
    PlateConverter,
    PlateCrosstalk,
    PlateDrift,
    PlateGain,
    PlateNoise,
    PlatePose,
)
from testbed.lab.instruments.plate_clock import PlateAntiAliasFilter, PlateDroppedSamples
from testbed.lab.instruments.plates import PLATES
from testbed.lab.kind_table import in_words
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.strategies import trees

NAMES, SAMPLES, SEED = ("a", "b", "c"), 500, 11
TIME = np.arange(SAMPLES) / 1000.0
TARE = np.array([1.0, -2.0, 245.0, 0.5, 0.25, -3.0])
NOISY = Instrument(encoder_noise=1e-3, torque_noise=0.5, force_noise=0.5, moment_noise=0.1)
SIGNALS = ("position", "torque", "wrench", "tare")
TABLE6 = ROOT / "experiments/table6.toml"


def truth(size: float = 1.0) -> Truth:
    """A swinging robot, or with size 0 nothing at all."""
    phase = np.outer(TIME, [3.0, 4.0, 5.0]) + np.arange(3.0)
    q, qd, qdd = size * np.sin(phase), 3 * size * np.cos(phase), -9 * size * np.sin(phase)
    return Truth(q, qd, qdd, 20 * qdd, qd, size * (TARE + np.hstack([40 * q, 30 * qd])))


def seen(*faults: Fault, what: Truth | None = None, base: Instrument = NOISY) -> Recording:
    instrument = replace(base, fault=faults)
    return measure(instrument, NAMES, TIME, what or truth(), TARE, {}, seed=SEED)


def wrench(recording: Recording) -> Array:
    return recording.measured("wrench")


def net(recording: Recording) -> Array:
    return np.asarray(wrench(recording) - np.asarray(recording.tare))


def same(one: Array | None, other: Array | None) -> None:
    np.testing.assert_array_equal(one, other)


def test_the_default_instrument_is_perfect_and_senses_no_kinematics() -> None:
    """Else noise that no file asks for is in a simulated recording, or speeds that no robot has."""
    what, blind = truth(), seen(base=Instrument())
    assert blind.signals == ("time", "position", "torque", "wrench")
    sensing = seen(base=Instrument(senses_kinematics=True))
    for recording in (blind, sensing):
        for signal in recording.signals[1:]:
            same(recording.measured(signal), getattr(what, signal))
    assert sensing.senses_kinematics
    same(blind.tare, TARE)


def test_noise_comes_from_the_streams_of_older_recordings() -> None:
    """Golden: a recording made again from its seed shows the same numbers in any version."""
    golden = {"encoder_noise": -0.2407279463145176, "torque_noise": -0.5346093661287762,
              "plate_noise": -2.0306006741711506, "encoder_resolution": -0.05591096996529509,
              "some_fault": -1.5672328128223696}  # fmt: skip
    assert {kind: stream(kind, 1996).normal() for kind in golden} == golden
    keys = [(kind, seed, n, use) for kind in golden for seed in (0, 1) for n in (0, 1)
            for use in ("", "tare")]  # fmt: skip
    assert len({stream(*key).normal() for key in keys}) == len(keys)
    errors = {"b": 0.08, "c": -0.02, "stranger": 9.0}
    shown = seen(base=replace(NOISY, encoder_resolution=0.25, torque_constant_error=errors))
    what = truth()
    q = what.position + 1e-3 * stream("encoder_noise", SEED).normal(size=(SAMPLES, 3))
    same(shown.position, 0.25 * np.round(q / 0.25))
    noise = 0.5 * stream("torque_noise", SEED).normal(size=(SAMPLES, 3))
    same(shown.torque, what.torque * [1.0, 1.08, 0.98] + noise)
    noise = np.repeat([0.5, 0.1], 3) * stream("plate_noise", SEED).normal(size=(SAMPLES, 6))
    same(shown.wrench, what.wrench + noise)


def test_a_fault_leaves_other_signals_and_the_noise_of_all_others_alone() -> None:
    without, silent = seen(), seen(what=truth(0))
    for kind, made in KINDS.items():
        fault = made()
        recording = seen(fault)
        for signal in SIGNALS:
            changed = getattr(recording, signal) != getattr(without, signal)
            assert changed.any() == (signal == fault.signal), (kind, signal)
        if fault.place >= Place.RANGE or kind in ("encoder_noise", "torque_noise", "plate_noise"):
            continue  # acts on the noise of the others as on all that it is given
        bare = seen(fault, what=truth(0)).measured(fault.signal)
        alone = seen(fault, what=truth(0), base=Instrument()).measured(fault.signal)
        np.testing.assert_allclose(bare - alone, silent.measured(fault.signal), atol=1e-12)


def test_two_of_one_kind_have_streams_of_their_own() -> None:
    """Of noise, and of the signs that chance decides."""
    one, two = (
        wrench(seen(*[PlateNoise()] * count, what=truth(0), base=Instrument())) for count in (1, 2)
    )
    assert abs(np.mean((two - one) * one)) < 0.1 * np.mean(one**2)
    assert np.mean(two**2) == pytest.approx(2 * np.mean(one**2), rel=0.1)
    every = Instrument(fault=(PlateBias(),) * 8).installed(NAMES, 0)["wrench"]
    assert len({str(fault) for fault in every if isinstance(fault, PlateBias)}) > 1


def test_places_decide_on_the_order_and_then_the_file() -> None:
    """Sensors, then noise, then counts, then the line; counts are whole whatever the noise."""
    faults = (PlateDroppedSamples(0.3), PlateConverter(), PlateNoise(), PlateCrosstalk())
    assert len({wrench(seen(*order)).tobytes() for order in permutations(faults)}) == 1
    gain, pose = PlateGain((0.5, 0.0, 0.0, 0.0, 0.0, 0.0)), PlatePose((0.0, 0.0, 1.0), 0.0)
    for order in ((gain, pose), (pose, gain)):
        expected = apply_chain(order, truth().wrench, TIME, 0)
        np.testing.assert_allclose(wrench(seen(*order, base=Instrument())), expected, atol=1e-12)
    counts = seen(EncoderResolution(0.25), EncoderNoise(0.1), EncoderEccentricity(0.1)).position
    same(counts / 0.25, np.rint(counts / 0.25))
    plate = Instrument(full_scale=tuple(10 * v for v in FULL_SCALE))  # type: ignore[arg-type]
    scale = np.array(plate.full_scale)
    coarse = scale / 128 * np.round(truth().wrench / scale * 128)
    same(wrench(seen(PlateConverter(8), base=plate)), coarse)


def test_a_measured_tare_has_the_plates_own_faults_and_noise_and_the_drift_since() -> None:
    """What is constant leaves with it: the wrench less the tare is as with a true zero."""
    quiet = Instrument()
    same(seen(PlateBias(), PlatePose(), PlateCrosstalk()).tare, TARE)
    for faults in ((PlateBias(),), (PlateBias(), PlateBias(1.0))):
        recording = seen(*faults, MeasuredTare(), base=quiet)
        np.testing.assert_allclose(net(recording), truth().wrench - TARE, atol=1e-10)
    for fault in (PlatePose(), PlateCrosstalk(), PlateGain()):
        bare = seen(fault, what=replace(truth(), wrench=truth().wrench - TARE), base=quiet)
        shown = net(seen(fault, MeasuredTare(), base=quiet))
        np.testing.assert_allclose(shown, wrench(bare), atol=1e-10)
    drift = seen(PlateDrift((0.05, 0.0, 0.0), 0.0), MeasuredTare(5.0, 60.0), base=quiet)
    np.testing.assert_allclose(np.asarray(drift.tare), TARE - 0.05 * 62.5005 * np.eye(6)[0])
    noisy = seen(MeasuredTare(1.0))
    same(noisy.wrench, seen().wrench)
    own = stream("plate_noise", SEED, 0, "tare").normal(size=(1000, 6)).mean(axis=0)
    np.testing.assert_allclose(
        np.asarray(noisy.tare), TARE + np.repeat([0.5, 0.1], 3) * own, atol=1e-12
    )


@given(tree=trees((1, 5)), kinds=st.sets(st.sampled_from(sorted(KINDS)), min_size=1))
def test_every_fault_suits_every_robot_and_needs_no_simulation(
    tree: tb.Tree, kinds: set[str]
) -> None:
    recording = ideal(tree, duration=3.0)
    faults = tuple(KINDS[kind]() for kind in sorted(kinds))
    shown = measured_again(recording, Instrument(rate=200.0, fault=faults), 5)
    for signal in ("position", "torque", "wrench"):
        values = shown.measured(signal)
        assert np.isfinite(values).all()
        if all(fault.signal != signal for fault in faults):
            same(values, recording.measured(signal))
    with refuses(RecordingError, "truth"):
        measured_again(recording.blind(), NOISY, 1)
    with refuses(RecordingError, "200", "1000"):
        measured_again(recording, NOISY, 1)


def test_a_file_says_faults_as_python_does_and_every_kind_is_documented() -> None:
    """Read with defaults, written back, listed in the docs with its keys; sizes are sizes."""
    every = ",".join(entry.example for entry in map(in_words, KINDS.values()))
    experiment = tb.Experiment.load(TABLE6, [f"measurement.fault=[{every}]"])
    assert [fault.kind for fault in experiment.measurement.fault] == list(KINDS)
    for kind, made in KINDS.items():
        fault = made()
        assert fault_of({"kind": kind}) == fault_of(fault.table()) == fault
        assert [name for name, _, _ in in_words(type(fault)).keys] == list(fault.known_keys())
        assert all(size > 0 for name, size in fault.table().items() if name != "kind")
    text = '[{kind="plate_bias",force=[1,2,3]},{kind="encoder_zero_error",error={elbow=1e-3}}]'
    found = tb.Experiment.load(TABLE6, [f"measurement.fault={text}"]).measurement.fault
    assert found == (PlateBias((1.0, 2.0, 3.0)), EncoderZeroError({"elbow": 1e-3}))
    assert catalogue() in (ROOT / "docs/instruments.md").read_text()


WRONG = {
    '{kind="plate_crosstalk",full_scale=1}': "full_scale",
    '{kind="plate_bias",force=[1,2]}': "[1, 2]",
    '{kind="plate_bias",force={waist=1}}': "waist",
    '{kind="plate_bias",force=true}': "True",
    '{kind="plate_bias",force=nan}': "force",
    '{kind="plate_bias",force=[1,2,-inf]}': "force",
    '{kind="plate_bias",force="much"}': "much",
    '{kind="torque_offset",error=[]}': "error",
    '{kind="encoder_zero_error",error={elbow="far"}}': "far",
    '{kind="plate_gain",error=[1,2,3]}': "six",
    '{kind="plate_hum",frequency=0}': "frequency",
    '{kind="plate_converter",bits=33}': "32",
    '{kind="plate_dropped_samples",share=1.5}': "1.5",
    '{kind="plate_crosstalk",matrix=[[1,2]]}': "matrix",
    '{kind="plate_anti_alias_filter",cutoff=1e-3}': "0.01 Hz",
    '{kind="measured_tare",seconds=1e6}': "measured_tare",
    '{kind="measured_tare"},{kind="measured_tare"}': "measured_tare",
    '{kind="torque_offset",error={wrist=1}}': "'wrist'",
}
"""A table that means nothing, and the culprit."""


def test_what_no_instrument_can_be_is_refused_before_anything_is_simulated() -> None:
    for text, culprit in WRONG.items():
        words = [f"measurement.fault=[{text}]", "motion.duration=1e3"]
        with refuses(TestbedError, culprit):
            tb.record(tb.Experiment.load(TABLE6, words))
    wrong: list[tuple[str, dict[str, Any]]] = [
        *((name, {name: value}) for value in (-1e-9, np.inf, np.nan)
          for name in ("encoder_resolution", "encoder_noise", "torque_noise", "moment_noise")),
        *(("rate", {"rate": value}) for value in (0.0, np.inf)),
        ("averaged", {"averaged": False, "fault": (EncoderInstantSampling(),)}),
        ("torque_constant_error", {"torque_constant_error": {"a": 0.1, "b": np.nan}}),
        *(("full_scale", {"full_scale": (1.0,) * 5 + more}) for more in ((), (0.0,))),
    ]  # fmt: skip
    for culprit, keys in wrong:
        with refuses(SettingsError, culprit):
            Instrument(**keys)
    assert Instrument(rate=100.0, fault=(PlateAntiAliasFilter(1e-3),)).fault


def test_a_plate_by_name_gives_what_is_not_said_beside_it() -> None:
    named = Instrument(plate="ati-axia80-m20", moment_noise=0.5)
    known = PLATES["ati-axia80-m20"]
    assert named.force_noise == known.force_noise > 0
    assert (named.moment_noise, named.full_scale) == (0.5, known.full_scale)
    again = tb.Experiment(name="x", model="x.urdf", measurement=named).as_toml()
    assert f"force_noise = {known.force_noise}" in again
    with refuses(SettingsError, "ati-axia80-m20"):
        Instrument(plate="axia80")
