"""What the documents say is so."""

from __future__ import annotations

import inspect
import re
import tomllib
from dataclasses import fields, is_dataclass
from itertools import chain
from pathlib import Path

import pytest

import testbed as tb
from testbed.experiment.experiment import Experiment
from testbed.experiment.experiment_tables import METRICS
from testbed.recordings.importing.mapping import Mapping
from tests.helpers.paths import ROOT

README = (ROOT / "README.md").read_text()


def code(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


@pytest.mark.slow
def test_the_readmes_python_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As printed, from a folder that holds the models and experiments."""
    for name in ("models", "experiments"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    blocks = code(README, "python")
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})


def test_ci_runs_the_readmes_own_test_line() -> None:
    assert "README.md" in (ROOT / ".ci/run").read_text()
    assert any("pytest" in block for block in code(README, "sh"))


def test_every_experiment_is_listed_with_its_figures() -> None:
    listed = (ROOT / "experiments/README.md").read_text()
    for path in (ROOT / "experiments").glob("*.toml"):
        assert path.name in listed


def test_every_key_and_metric_is_documented() -> None:
    text = (ROOT / "docs/experiments.md").read_text()
    for metric in METRICS:
        assert f"`{metric}`" in text
    for key in keys(Experiment):
        assert f"`{key}`" in text, key


def test_every_key_of_a_mapping_is_documented() -> None:
    text = (ROOT / "docs/real-recordings.md").read_text()
    for key in keys(Mapping):
        assert re.search(rf"`{key}`", text), key


def keys(model: type) -> list[str]:
    found = []
    for name, field in model.model_fields.items():  # type: ignore[attr-defined]
        found.append(name)
        for inner in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if inspect.isclass(inner) and hasattr(inner, "model_fields"):
                found += keys(inner)
            elif is_dataclass(inner):
                found += [each.name for each in fields(inner)]
    return found


def test_every_dependency_is_justified() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    text = (ROOT / "docs/dependencies.md").read_text()
    for requirement in wanted:
        name = re.split(r"[<>=\[ ]", requirement)[0]
        assert f"`{name}`" in text, name


@pytest.mark.parametrize("name", [n for n in tb.__all__ if inspect.isfunction(getattr(tb, n))])
def test_every_public_argument_is_documented(name: str) -> None:
    function = getattr(tb, name)
    said = inspect.getdoc(function) or ""
    for argument in inspect.signature(function).parameters:
        assert re.search(rf"^ +{argument}: ", said, flags=re.MULTILINE) or (
            len(inspect.signature(function).parameters) == 1
        ), f"{name}: {argument}"
