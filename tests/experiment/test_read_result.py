"""Results read back: what was written is what is read, and nothing else passes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import TestbedError
from testbed.experiment.experiment import RecordingTables
from testbed.experiment.read_result import LARGEST_RESULT, read_result
from testbed.experiment.results import identified_as_json
from testbed.identification.estimate import METHODS, Estimate
from testbed.identification.validate import validate
from testbed.robot.model_file import ModelFile
from tests.helpers.measured import measured
from tests.helpers.runs import MODELS

SAID = ["identification.zeros=true", "identification.cutoff=6", "robot.lock.waist=0.5"]
HELD = ModelFile(MODELS["puma"], lock={"waist": 0.4, "elbow": None})


@pytest.fixture(scope="module")
def estimates() -> list[Estimate]:
    tree, settings = HELD.tree(), RecordingTables.of(SAID).identification
    recording = measured(tree, 1, duration=12)
    return [tb.identify(tree, recording, method, settings=settings) for method in METHODS]


@pytest.fixture(scope="module")
def content(estimates: list[Estimate]) -> dict[str, Any]:
    return identified_as_json(estimates, HELD, RecordingTables.of(SAID))


def written(folder: Path, content: object) -> Path:
    path = folder / "result.json"
    path.write_text(json.dumps(content))
    return path


def test_what_was_written_validates_to_the_same_bits(
    estimates: list[Estimate], content: dict[str, Any], tmp_path: Path
) -> None:
    kept = read_result(written(tmp_path, content))
    assert kept.settings == RecordingTables.of(SAID).identification
    assert kept.tree.names == HELD.tree().names == ("shoulder",)
    other = measured(kept.tree, 2, duration=9)
    for estimate, said in zip(estimates, kept.estimates, strict=True):
        one = validate(HELD.tree(), other, estimate, settings=kept.settings)
        two = validate(kept.tree, other, said, settings=kept.settings)
        np.testing.assert_array_equal(one.ratio, two.ratio)
        np.testing.assert_array_equal(one.mean, two.mean)


def test_the_model_may_have_moved_but_is_the_same(content: dict[str, Any], tmp_path: Path) -> None:
    gone = content | {"model": content["model"] | {"path": "gone.xml"}}
    path = written(tmp_path, gone)
    with pytest.raises(TestbedError, match="--model"):
        read_result(path)
    assert read_result(path, MODELS["puma"]).tree.n == 1
    with pytest.raises(TestbedError, match="SHA-256"):
        read_result(path, MODELS["ur5"])


def test_settings_can_be_overridden(content: dict[str, Any], tmp_path: Path) -> None:
    kept = read_result(written(tmp_path, content), settings=["identification.deadband=0.1"])
    assert kept.settings.deadband == 0.1
    assert kept.settings.cutoff == 6


Spoiler = Callable[[dict[str, Any]], object]


def put(*keys: str | int, value: object) -> Spoiler:
    """With another value in one place."""

    def spoil(content: dict[str, Any]) -> object:
        here: Any = content
        for key in keys[:-1]:
            here = here[key]
        here[keys[-1]] = value
        return content

    return spoil


def left_out(*keys: str) -> Spoiler:
    def spoil(content: dict[str, Any]) -> object:
        here = content
        for key in keys[:-1]:
            here = here[key]
        del here[keys[-1]]
        return content

    return spoil


SPOILED: dict[str, Spoiler] = {
    "a list": lambda content: [content],
    "a number": lambda content: 3,
    "nothing in it": lambda content: {},
    "no estimates": lambda content: {"model": content["model"]},
    "estimate is text": put("external", value="good"),
    "estimate is null": put("external", value=None),
    "no names": left_out("external", "names"),
    "no covariance": left_out("internal", "covariance"),
    "no nuisances": left_out("external", "nuisances"),
    "no settings": left_out("settings"),
    "settings are a list": put("settings", value=[1]),
    "settings unknown": put("settings", "identification", "cutof", value=3),
    "settings wrong": put("settings", "identification", "cutoff", value=-3),
    "model is text": put("model", value="puma.xml"),
    "model without hash": left_out("model", "sha256"),
    "another hash": put("model", "sha256", value="0" * 64),
    "path is a folder": put("model", "path", value="/"),
    "path with a zero byte": put("model", "path", value="a\0b.xml"),
    "path far too long": put("model", "path", value="x" * 100_000),
    "lock of no joint": put("model", "lock", value={"nobody": 0.0}),
    "nan": put("external", "values", 0, value=float("nan")),
    "infinite": put("external", "covariance", 0, 0, value=float("inf")),
    "a huge integer": put("external", "values", 0, value=10**400),
    "values are text": put("external", "values", 0, value="1.0"),
    "values too few": put("external", "values", value=[1.0]),
    "covariance not square": put("external", "covariance", value=[[1.0]]),
    "covariance ragged": put("external", "covariance", 0, value=[1.0]),
    "gravity of two": put("external", "gravity", value=[0.0, -9.81]),
    "residual negative": put("external", "residual", 0, value=-1.0),
    "nuisances are numbers": put("external", "nuisances", value=[1.0]),
    "no model, no run folder": left_out("model"),
}


@pytest.mark.parametrize("spoil", SPOILED.values(), ids=SPOILED)
def test_what_is_no_result_is_refused_in_one_line(
    spoil: Spoiler, content: dict[str, Any], tmp_path: Path
) -> None:
    path = written(tmp_path, spoil(json.loads(json.dumps(content))))
    with pytest.raises((TestbedError, OSError)) as error:
        read_result(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"PAR1", "not JSON"),
        (b'{"external": ', "not JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"external": ' + b"[" * 500 + b"]" * 500 + b"}", "external"),
        (b'{"external": {"names": ' + b"9" * 10_000 + b"}}", "not JSON"),
        (b" " * (LARGEST_RESULT + 1), "bytes"),
    ],
    ids=["empty", "utf-16", "parquet", "half", "deep", "deep inside", "digits", "huge"],
)
def test_what_is_not_json_is_refused_in_one_line(text: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(text)
    with pytest.raises((TestbedError, OSError), match=said) as error:
        read_result(path)
    assert "\n" not in str(error.value)


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TestbedError, match="no folder of a run"):
        read_result(tmp_path)
    with pytest.raises(TestbedError, match="there is no result"):
        read_result(tmp_path / "nowhere")
