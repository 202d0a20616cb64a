"""Faults in experiment files: read, refused in one line, written back, listed and explained."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import SettingsError, TestbedError
from testbed.instruments.catalogue import as_markdown, catalogue, entry_of
from testbed.instruments.chain import Instrument
from testbed.instruments.drives import TorqueRipple
from testbed.instruments.encoders import (
    EncoderEccentricity,
    EncoderInstantSampling,
    EncoderZeroError,
)
from testbed.instruments.fault import Fault, Place, Rig
from testbed.instruments.faults import KINDS, fault_of
from testbed.instruments.plate_clock import PlateAntiAliasFilter
from testbed.instruments.plate_noise import PlateBias
from testbed.instruments.tare import MeasuredTare
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT

TABLE6 = ROOT / "experiments/table6.toml"


def faults(text: str) -> tuple[Fault, ...]:
    """Of an experiment with `--set measurement.fault=TEXT`."""
    return tb.Experiment.load(TABLE6, [f"measurement.fault={text}"]).measurement.fault


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_with_defaults_and_written_back(kind: str) -> None:
    fault = KINDS[kind]()
    assert faults(f'[{{kind="{kind}"}}]') == (fault,)
    assert fault_of(fault.table()) == fault
    assert fault_of(fault) is fault


def test_a_file_with_all_of_them_says_the_same_when_written_out(tmp_path: Path) -> None:
    every = ",".join(entry.example for entry in catalogue())
    experiment = tb.Experiment.load(TABLE6, [f"measurement.fault=[{every}]"])
    assert len(experiment.measurement.fault) == len(KINDS)
    path = tmp_path / "again.toml"
    path.write_text(experiment.as_toml())
    again = tb.Experiment.load(path)
    assert again == experiment
    assert again.as_toml() == experiment.as_toml()


def test_tables_in_the_file_say_what_set_says(tmp_path: Path) -> None:
    text = TABLE6.read_text().replace("../models", str(ROOT / "models"))
    text += '\n[[measurement.fault]]\nkind = "plate_bias"\nforce = [1, 2, 3]\n'
    text += '\n[[measurement.fault]]\nkind = "encoder_zero_error"\nerror = { elbow = 1e-3 }\n'
    path = tmp_path / "faulty.toml"
    path.write_text(text)
    found = tb.Experiment.load(path).measurement.fault
    assert found == (PlateBias((1.0, 2.0, 3.0)), EncoderZeroError({"elbow": 1e-3}))
    said = '[{kind="plate_bias",force=[1,2,3]},{kind="encoder_zero_error",error={elbow=1e-3}}]'
    assert faults(said) == found
    assert tb.Experiment.load(path, ["measurement.fault=[]"]).measurement.fault == ()


def test_python_says_the_same(tmp_path: Path) -> None:
    instrument = Instrument(fault=(PlateBias((1.0, 2.0, 3.0)), TorqueRipple({"elbow": 0.1})))
    experiment = tb.Experiment(
        name="made", model=str(ROOT / "models/puma562.xml"), measurement=instrument
    )
    path = tmp_path / "made.toml"
    path.write_text(experiment.as_toml())
    assert tb.Experiment.load(path).measurement == instrument


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[{kind="plate_bais"}]', "unknown kind of fault 'plate_bais'; did you mean 'plate_bias'?"),
        ('[{kind="x"}]', "`testbed faults` lists all"),
        (
            '[{kind="plate_bias",forse=1}]',
            "unknown key of plate_bias 'forse'; did you mean 'force'",
        ),
        ('[{kind="plate_bias",full_scale=1}]', "(known: force, moment)"),
        ('[{kind="encoder_instant_sampling",size=1}]', "unknown key of encoder_instant_sampling"),
        ('[{kind="plate_bias",force="big"}]', "force is a number, or a list of three (x, y, z)"),
        ('[{kind="plate_bias",force=[1,2]}]', "found [1, 2]"),
        ('[{kind="plate_bias",force=[]}]', "found []"),
        ('[{kind="plate_bias",force={waist=1}}]', "found {'waist': 1}"),
        ('[{kind="plate_bias",force=true}]', "found True"),
        ('[{kind="plate_bias",force=nan}]', "found nan"),
        ('[{kind="plate_bias",force=inf}]', "found inf"),
        ('[{kind="plate_bias",force=1e300}]', "found 1e+300"),
        ('[{kind="plate_gain",error=[1,2,3]}]', "a list of six (Fx, Fy, Fz, Mx, My, Mz)"),
        ('[{kind="plate_hum",frequency=0}]', "frequency is a positive number, found 0"),
        ('[{kind="plate_hum",frequency=[50]}]', "frequency is a positive number, found [50]"),
        (
            '[{kind="plate_converter",bits=12.5}]',
            "bits is a whole number at least 1 and at most 32",
        ),
        ('[{kind="plate_converter",bits=0}]', "found 0"),
        ('[{kind="plate_jitter",sigma=-1.0}]', "sigma is a number at least 0, found -1.0"),
        ('[{kind="plate_dropped_samples",share=1.5}]', "at most 1, found 1.5"),
        ('[{kind="plate_crosstalk",matrix=[[1,2]]}]', "matrix is six lists of six numbers"),
        ('[{kind="plate_crosstalk",matrix=3}]', "matrix is six lists of six numbers"),
        ('[{kind="encoder_zero_error",error={elbow="x"}}]', "or a table by joint name"),
        ('[{kind="plate_anti_alias_filter",cutoff=1e-3}]', "too low for a rate of 1000 Hz"),
        ('[{kind="measured_tare",seconds=1e6}]', "measure for a shorter time"),
        ('[{kind="measured_tare"},{kind="measured_tare"}]', "more than once"),
        ("[{force=1}]", 'a fault is a table with its kind, as { kind = "plate_bias" }'),
        ("[{kind=3}]", "a fault is a table with its kind"),
        ("[3]", "a fault is a table with its kind"),
        ("3", "measurement.fault"),
    ],
)
def test_what_is_not_understood_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(TestbedError) as caught:
        faults(text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[{kind="torque_offset",error={wrist=1}}]', "'wrist', the model has waist, shoulder"),
        ('[{kind="torque_offset",error=[1,2]}]', "error has 2 numbers for 3 joints"),
    ],
)
def test_other_joints_are_refused_before_anything_is_simulated(text: str, said: str) -> None:
    settings = [f"measurement.fault={text}", "motion.duration=1e3"]
    with pytest.raises(TestbedError, match=said):
        tb.simulate(tb.Experiment.load(TABLE6, settings))


def test_tables_by_joint_leave_the_others_alone() -> None:
    rig = Rig(("a", "b", "c"))
    assert EncoderZeroError({"b": 2.0}).on(rig).error == (0.0, 2.0, 0.0)
    wave = EncoderEccentricity({"a": 1e-3}, period={"c": 0.01}, phase={"b": 1.0}).on(rig)
    assert wave.amplitude == (1e-3, 0.0, 0.0)
    assert wave.period == (2 * np.pi, 2 * np.pi, 0.01)
    assert wave.phase == (0.0, 1.0, 0.0)
    with pytest.raises(SettingsError, match="unknown joint 'd'"):
        EncoderZeroError({"d": 1.0}).on(rig)


def test_instants_cannot_be_made_of_instants() -> None:
    with pytest.raises(SettingsError, match="leave one of them out"):
        Instrument(averaged=False, fault=(EncoderInstantSampling(),))


def test_what_suits_a_rate_may_not_suit_another() -> None:
    assert Instrument(rate=100.0, fault=(PlateAntiAliasFilter(1e-3),)).fault
    with pytest.raises(SettingsError, match="raise it to 0.01 Hz"):
        Instrument(rate=1000.0, fault=(PlateAntiAliasFilter(1e-3),))
    with pytest.raises(SettingsError, match="more than 1e"):
        Instrument(rate=1e6, fault=(MeasuredTare(),))


@pytest.mark.parametrize("scale", [(1.0,) * 5, (1.0,) * 5 + (0.0,), (1.0,) * 5 + (float("nan"),)])
def test_a_full_scale_that_is_none_is_refused(scale: Any) -> None:
    with pytest.raises(SettingsError, match="full_scale is six positive numbers"):
        Instrument(full_scale=scale)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_says_what_it_is_how_large_and_why(kind: str) -> None:
    fault, entry = KINDS[kind](), entry_of(kind)
    assert fault.kind == kind
    assert fault.place in Place
    assert entry.summary.endswith(".")
    assert entry.source.endswith(".")
    assert [name for name, _, _ in entry.keys] == list(fault.known_keys())
    assert all(meaning.endswith(".") for _, _, meaning in entry.keys)
    shown = {f.name for f in fields(fault) if f.repr}
    assert shown == set(fault.known_keys())
    sizes = [value for name, value in fault.table().items() if name != "kind"]
    assert all(size > 0 for size in sizes)
    read = fault_of(tomllib.loads(f"fault = {entry.example}")["fault"])
    for name, value in fault.table().items():
        assert read.table()[name] == (value if name == "kind" else pytest.approx(value, rel=1e-5))


def test_the_document_lists_all_as_they_are() -> None:
    """`python -m docs.instruments` writes it anew."""
    from docs.instruments import BEGIN, END

    text = (ROOT / "docs/instruments.md").read_text()
    assert text.partition(BEGIN)[2].partition(END)[0] == as_markdown()


@pytest.mark.slow
def test_the_command_lists_all_and_shows_one(tmp_path: Path) -> None:
    listed = command_line("faults", cwd=tmp_path).stdout
    assert [line.split()[0] for line in listed.splitlines()[: len(KINDS)]] == list(KINDS)
    one = command_line("faults", "plate_pose", cwd=tmp_path).stdout
    assert "rotation = 0.0035: Vector of the rotation R [rad]." in one
    assert '{ kind = "plate_pose", rotation = 0.0035, translation = 0.001 }' in one
    wrong = command_line("faults", "plate_posse", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "did you mean 'plate_pose'?" in wrong.stderr
    assert "testbed faults" in command_line("run", "--help", cwd=tmp_path).stdout
