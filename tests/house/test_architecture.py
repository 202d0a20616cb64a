"""The house keeps its plan: imports go upstream, guests stay in their rooms, no circle."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import testbed as tb
from tests.helpers.paths import ROOT

HOUSE = ROOT / "testbed"
MODULES = sorted(HOUSE.rglob("*.py"))

BASE = (
    "errors codec arrays files blas diagnostics child_process file_kinds frames installation "
    "summary_table"
)
ROBOT = f"{BASE} robot parameters dynamics"
DATA = f"{ROBOT} excitation recordings identification experiment campaign"
PLAN = {
    name: set(needs.split())
    for name, needs in {
        **dict.fromkeys([*BASE.split(), "codec", "stages"], ""),
        **dict.fromkeys(["arrays", "diagnostics"], "codec"),
        "blas": "arrays",
        "child_process": "errors",
        "frames": "errors",
        "summary_table": "arrays codec",
        "kind_table": "errors arrays",
        "file_kinds": "errors",
        "toml_text": "errors file_kinds",
        "robot": BASE,
        "parameters": f"{BASE} robot",
        "dynamics": f"{BASE} robot parameters",
        "kernel": ROBOT,
        "symbolic": ROBOT,
        "excitation": f"{ROBOT} kernel installation toml_text",
        "recordings": f"{ROBOT} toml_text",
        "instruments": f"{BASE} kind_table robot recordings",
        "simulation": f"{BASE} kind_table robot dynamics kernel excitation recordings",
        "identification": f"{ROBOT} kernel recordings stages",
        "plausibility": f"{ROBOT} toml_text recordings identification",
        "experiment": f"{ROBOT} kind_table toml_text excitation recordings "
        "instruments simulation identification",
        "campaign": f"{BASE} toml_text robot recordings identification experiment",
        "reporting": f"{DATA} plausibility stages",
        "viewer": f"{DATA} stages reporting",
    }.items()
}
"""What a room may import, besides itself. docs/architecture.md draws the same plan."""
ANYWHERE = {"__init__", "__main__", "cli"}
GUESTS = {
    "mujoco": "robot/formats/mjcf robot/formats/mjcf.py robot/visuals/mjcf_shapes.py "
    "simulation/ excitation/collision_model.py excitation/clearance.py",
    "pinocchio": "robot/formats/urdf.py robot/visuals/urdf_shapes.py",
    "coal": "robot/visuals/urdf_shapes.py",
    "rerun": "viewer/ recordings/importing/readers/rerun_log.py",
    "clarabel": "identification/diagnostics/rigid_bodies.py",
    "numba": "kernel/",
    "llvmlite": "kernel/compiler.py",
    "threadpoolctl": "blas.py",
    "pyarrow": "recordings/formats/parquet.py campaign/ "
    "recordings/importing/readers/parquet_columns.py recordings/importing/readers/lerobot.py "
    "recordings/importing/readers/rerun_log.py",
    "distributed": "campaign/cluster.py",
    "dask": "campaign/cluster.py",
    "h5py": "recordings/importing/readers/hdf5.py",
    "rosbags": "recordings/importing/readers/ros_bag.py",
    **dict.fromkeys(("mcap", "google", "lz4"), "recordings/importing/readers/mcap.py"),
    "zstandard": "recordings/importing/readers/mcap.py recordings/importing/readers/ros_bag.py",
    "pydantic": "codec.py identification/settings.py excitation/motion_file.py experiment/ "
    "campaign/ toml_text.py recordings/importing/mapping.py",
    "pydantic_core": "codec.py",
    "tomli_w": "excitation/motion_file.py experiment/ campaign/results.py",
    "typer": "cli/",
    "rich": "reporting/",
    "matplotlib": "reporting/plot.py reporting/portrait.py",
    "jinja2": "reporting/output.py",
    "markupsafe": "reporting/output.py",
    "subprocess": "viewer/live.py child_process.py",  # Rerun's viewer; calls that may crash
}
"""Packages that only some modules may import, by how these begin."""
FORBIDDEN = ("pickle", "shelve", "marshal", "requests", "urllib", "http")
LONGEST_MODULE = 500


TREES = {path: ast.parse(path.read_text()) for path in MODULES}


def module_name(path: Path) -> str:
    parts = path.relative_to(HOUSE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def room(path: Path) -> str:
    return path.relative_to(HOUSE).parts[0].removesuffix(".py")


def imported(path: Path, *, types: bool = True) -> Iterator[str]:
    """Modules that a module imports, lazily or not, and what could be one.

    Args:
        path: Of the module.
        types: Whether those for types alone count.
    """
    for part in TREES[path].body:
        if not types and isinstance(part, ast.If) and ast.unparse(part.test) == "TYPE_CHECKING":
            continue
        for node in ast.walk(part):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: imports are absolute"
                yield node.module or ""
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


def stuck(needs: dict[str, set[str]]) -> set[str]:
    """What stands in a circle, or behind one."""
    done: set[str] = set()
    while ready := {name for name, wants in needs.items() if name not in done and wants <= done}:
        done |= ready
    return set(needs) - done


def test_imports_go_upstream_only_and_guests_stay_in_their_rooms() -> None:
    """See docs/architecture.md for who may import whom."""
    for path in MODULES:
        place, names = path.relative_to(HOUSE).as_posix(), set(imported(path))
        own = {name.split(".")[1] for name in names if name.startswith("testbed.")}
        if room(path) not in ANYWHERE:
            assert own <= {room(path), *PLAN[room(path)]}, f"{place} imports {own}"
        for guest in {name.split(".")[0] for name in names}:
            assert guest not in FORBIDDEN, f"{place} imports {guest}"
            assert place.startswith(tuple(GUESTS.get(guest, place).split())), (place, guest)


def test_neither_rooms_nor_files_need_each_other_in_a_circle() -> None:
    assert stuck(PLAN) == set()
    names = {module_name(path) for path in MODULES}
    needs = {module_name(p): names.intersection(imported(p, types=False)) for p in MODULES}
    inner = {name: wants - {name, "testbed"} for name, wants in needs.items() if name != "testbed"}
    assert stuck(inner) == set()


def test_every_room_is_in_the_plan_and_in_the_drawing() -> None:
    rooms = {room(path) for path in MODULES} - ANYWHERE
    assert rooms == set(PLAN)
    drawing = (ROOT / "docs/architecture.md").read_text()
    assert [name for name in rooms if not re.search(rf"\b{name}\b", drawing)] == []


def test_the_estimator_never_speaks_of_the_truth() -> None:
    """Nothing in it reads what only a simulation knows, or runs text as code."""
    for path in (path for path in MODULES if room(path) == "identification"):
        for node in ast.walk(TREES[path]):
            if isinstance(node, ast.Attribute):
                assert node.attr not in ("truth", "inertias", "pedestal", "coulomb"), path
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "barycentric", "standard"), path


def test_no_module_is_longer_than_a_person_reads() -> None:
    lengths = {path.relative_to(HOUSE): path.read_text().count("\n") for path in MODULES}
    assert {name: lines for name, lines in lengths.items() if lines > LONGEST_MODULE} == {}


@pytest.mark.slow
def test_values_are_frozen_and_those_with_arrays_are_themselves_alone() -> None:
    """What others hold cannot change under them, and `==` has one answer."""
    for module in sorted(module_name(p) for p in MODULES if p.name != "__main__.py"):
        for each in vars(importlib.import_module(module)).values():
            if isinstance(each, type) and each.__module__ == module:
                if issubclass(each, BaseModel):
                    assert each.model_config.get("frozen"), each
                elif dataclasses.is_dataclass(each) and not each.__name__.startswith("_"):
                    asked: Any = each.__dict__["__dataclass_params__"]
                    arrays = any("Array" in str(f.type) for f in dataclasses.fields(each))
                    assert asked.frozen, each
                    assert not (asked.eq and arrays), each


def test_what_is_promised_is_there_and_nothing_else() -> None:
    promised = vars(tb)["__all__"]
    assert [name for name in promised if not getattr(tb, name).__doc__] == []
    with pytest.raises(AttributeError):
        getattr(tb, "nothing")  # noqa: B009


def test_no_module_gives_one_name_two_meanings() -> None:
    """If one fails, a constant silently has the value of its namesake further down."""
    for path in MODULES:
        targets = [t for n in TREES[path].body if isinstance(n, ast.Assign) for t in n.targets]
        names = [x.id for t in targets for x in ast.walk(t) if isinstance(x, ast.Name)]
        assert len(set(names)) == len(names), path


def test_nothing_names_a_machine_or_a_registry() -> None:
    texts = [ROOT / name for name in ("README.md", "CHANGELOG.md", "pyproject.toml", ".ci/run")]
    texts += [*MODULES, *(ROOT / "docs").glob("*.md"), *(ROOT / "experiments").rglob("*.*")]
    texts += list(ROOT.glob("*.lock"))
    for path in texts:
        found = re.search(r"/(work|root|home)/|\.\./shared|pypi\.|--index-url", path.read_text())
        assert not found, f"{path}: {found}"
