"""What pyproject.toml promises, and what else says it: Python's versions, pins, extras."""

from __future__ import annotations

import re
import tomllib

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from tests.helpers.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
ABOUT = PROJECT["project"]
EXTRAS = {
    extra: [Requirement(text) for text in texts]
    for extra, texts in ABOUT["optional-dependencies"].items()
}
NEEDED = [Requirement(text) for text in ABOUT["dependencies"]]


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_lock_pins_what_is_permitted_and_nothing_needed_is_left_out() -> None:
    text = (ROOT / "requirements.lock").read_text()
    pins = re.findall(r"^([\w.-]+)==([^\s;]+)", text, re.MULTILINE)
    for each in (*NEEDED, *EXTRAS["dev"]):
        versions = [version for name, version in pins if name == canonical(each.name)]
        assert versions, each
        assert all(each.specifier.contains(version) for version in versions), (each, versions)


def test_tests_need_the_same_versions_of_an_extra_as_its_users() -> None:
    tested = {each.name: each.specifier for each in EXTRAS["dev"]}
    used = {each.name: each.specifier for each in EXTRAS["import"]}
    assert {name: tested[name] for name in used} == used


def test_every_requirement_has_a_lowest_version() -> None:
    for each in (*NEEDED, *EXTRAS["dev"], *EXTRAS["import"]):
        assert any(bound.operator in (">=", "==") for bound in each.specifier), each


def test_the_first_python_of_the_classifiers_is_the_one_that_is_required() -> None:
    marks = [text.rpartition(" ")[2] for text in ABOUT["classifiers"] if ":: 3." in text]
    assert all(SpecifierSet(ABOUT["requires-python"]).contains(mark) for mark in marks)
    assert ABOUT["requires-python"] == f">={marks[0]}"
    assert PROJECT["tool"]["ruff"]["target-version"] == f"py{marks[0].replace('.', '')}"
    minor = [int(mark.partition(".")[2]) for mark in marks]
    assert minor == [*range(minor[0], minor[-1] + 1)]
