"""What every room relies on: arrays that stay, keys that are checked, files that are shipped."""

from __future__ import annotations

import tomllib
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from testbed.core.base.arrays import readonly_array
from testbed.core.base.blas import eigh, one_blas_thread
from testbed.core.base.errors import UnknownName, printable_line
from testbed.core.base.installation import (
    DISTRIBUTION,
    installed_version,
    shipped,
    user_or_shipped_file,
)
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.strategies import few


def test_what_a_value_was_made_of_cannot_change_it_and_wrong_shapes_are_named() -> None:
    """An estimate would change with a list that somebody goes on using."""
    loose = np.zeros(3)
    kept = readonly_array(loose, (3,), "speed")
    loose[0] = 1.0
    assert kept[0] == 0.0
    assert not kept.flags.writeable
    assert readonly_array([[1]], (1, None), "t").dtype == np.float64
    assert np.shares_memory(readonly_array(kept[1:], (2,), "speed"), kept)  # no copy without need
    for shape in [(2,), (3, 1), (), (4,)]:
        with refuses(ValueError, "speed", str(shape)):
            readonly_array(np.zeros(shape), (3,), "speed")


def test_one_thread_is_used_meanwhile_and_as_many_as_before_afterwards() -> None:
    """Threads that wait for each other make small matrices ten times slower."""

    def threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    np.linalg.inv(np.eye(3))  # the library is there
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == before


@given(st.text(max_size=40), st.integers(1, 20), st.integers(20, 500))
@few(10)
def test_a_message_from_any_file_is_one_line_that_no_terminal_obeys(
    text: str, times: int, limit: int
) -> None:
    """Names of a model file could clear a screen, or drive everything else off it."""
    shown, plain = printable_line(text * times, limit), " ".join((text * times).split())
    assert shown == "" or shown.isprintable()
    assert len(shown) <= limit == len(printable_line("x" * 501, limit))
    if plain.isprintable():
        assert shown == plain or len(plain) > limit
        start, _, end = shown.partition("...")
        assert plain.startswith(start.strip())
        assert plain.endswith(end.rpartition("...")[2].strip())
    near = UnknownName("column", "elbow torqe", ["w" * 201, *map(str, range(40)), "elbow torque"])
    assert "'elbow torque'" in str(near)  # of many names the nearest
    assert len(str(near)) < 300


def test_eigenvalues_are_found_where_divide_and_conquer_gives_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As it does on the iCub's equations."""
    root = np.random.default_rng(3).normal(size=(40, 40))
    matrix = root @ root.T
    usual, _ = eigh(matrix)
    monkeypatch.setattr(np.linalg, "eigh", Mock(side_effect=np.linalg.LinAlgError))
    sizes, axes = eigh(matrix)
    np.testing.assert_allclose(sizes, usual, atol=1e-10 * usual[-1])
    np.testing.assert_allclose(matrix @ axes, axes * sizes, atol=1e-10 * usual[-1])


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_shipped_files_are_found_by_short_names_and_an_own_file_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`testbed run table6` works in any folder; `testbed run ../x` opens no file of the package."""
    for file in (ROOT / "experiments").rglob("*.toml"):
        name = file.relative_to(ROOT / "experiments").with_suffix("")
        assert shipped(str(name)) == shipped(f"experiments/{name}.toml") == file
    for other in ("../pyproject.toml", "/etc/passwd", "nothing", "", "models"):
        with refuses(FileNotFoundError, other):
            shipped(other)
    monkeypatch.chdir(tmp_path)
    assert user_or_shipped_file("puma562.xml") == ROOT / "models/puma562.xml"
    Path("puma562.xml").touch()
    assert user_or_shipped_file("puma562.xml") == Path("puma562.xml")


def test_an_installed_package_holds_all_that_its_experiments_refer_to() -> None:
    """Else they fail for everybody but developers."""
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert all(place == f"testbed/shipped/{source}" for source, place in included.items())
    for file in (ROOT / "experiments").glob("*.toml"):
        for word in file.read_text().replace('"', " ").replace("=", " ").split():
            if word.startswith("../"):
                target = (file.parent / word).resolve()
                assert target.exists(), (file, word)
                assert any(target.is_relative_to(ROOT / place) for place in included), (file, word)


def test_the_version_is_the_projects() -> None:
    assert (PROJECT["project"]["name"], PROJECT["project"]["version"]) == (
        DISTRIBUTION,
        installed_version(),
    )
    assert f"\nversion: {installed_version()}\n" in (ROOT / "CITATION.cff").read_text()
