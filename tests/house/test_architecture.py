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
from tests.helpers.modules import HOUSE, MODULES, module_name, syntax
from tests.helpers.paths import ROOT

ROBOT = "core/base core/robot core/parameters core/dynamics"
CORE = f"{ROBOT} core/kernel core/recordings sensors core/estimation"
LAB = "lab/instruments lab/simulation lab/experiment"
LIBRARY = f"{CORE} bodies motion applications lab {LAB} importing importing/check"
PLAN = {
    "core/base": "",
    "core/robot": "core/base",
    "core/parameters": "core/base core/robot",
    "core/dynamics": "core/base core/robot core/parameters",
    "core/kernel": ROBOT,
    "core/recordings": ROBOT,
    "sensors": f"{ROBOT} core/recordings",
    "core/estimation": f"{ROBOT} core/kernel core/recordings sensors",
    "bodies": CORE,
    "motion": f"{ROBOT} core/kernel bodies",
    "applications": f"{CORE} bodies",
    "importing": f"{ROBOT} core/recordings sensors",
    "importing/check": f"{CORE} bodies importing",
    "lab/instruments": "core/base core/robot core/recordings sensors lab",
    "lab/simulation": f"{ROBOT} core/kernel core/recordings sensors motion lab",
    "lab/experiment": f"{CORE} bodies motion applications lab lab/instruments lab/simulation",
    "lab": "",
    "equations": ROBOT,
    "view": f"{LIBRARY} equations",
    "campaigns": f"{LIBRARY} view",
}
"""Folders that a folder may import, besides its own. docs/architecture.md draws the same plan."""
ANYWHERE = {"__init__.py", "__main__.py", "cli"}
GUESTS = {
    "mujoco": "core/robot/formats/mjcf bodies/edit_mjcf.py bodies/shapes/mjcf_shapes.py "
    "lab/simulation/ motion/collision_model.py motion/clearance.py",
    "pinocchio": "core/robot/formats/urdf.py bodies/shapes/urdf_shapes.py",
    "coal": "bodies/shapes/urdf_shapes.py",
    "rerun": "view/viewer/ importing/readers/rerun_log.py",
    "clarabel": "core/estimation/diagnostics/rigid_bodies.py",
    "numba": "core/kernel/",
    "llvmlite": "core/kernel/compiler.py",
    "threadpoolctl": "core/base/blas.py",
    "pyarrow": "core/recordings/formats/parquet.py campaigns/ "
    "importing/readers/parquet_columns.py importing/readers/lerobot.py "
    "importing/readers/rerun_log.py",
    "h5py": "importing/readers/hdf5.py",
    "rosbags": "importing/readers/ros_bag.py",
    **dict.fromkeys(("mcap", "google"), "importing/readers/mcap.py"),
    "zstandard": "importing/readers/ros_bag.py",
    "pydantic": "core/base/codec.py core/base/toml_text.py core/estimation/settings.py "
    "lab/experiment/ motion/motion_file.py campaigns/ importing/mapping.py",
    "pydantic_core": "core/base/codec.py",
    "tomli_w": "lab/experiment/ motion/motion_file.py",
    "typer": "cli/",
    "rich": "view/ campaigns/campaign_section.py",
    "matplotlib": "view/drawing.py",
    "jinja2": "view/output.py lab/experiment/new_experiment.py",
    "markupsafe": "view/output.py",
    "subprocess": "view/viewer/live.py core/base/child_process.py",  # the viewer; what may crash
}
"""Packages that only some modules may import, by how these begin."""
FORBIDDEN = ("pickle", "shelve", "marshal", "requests", "urllib", "http")
LONGEST_MODULE = 500
ESTIMATORS = ["linear_prior", "posterior", "verdict", "row_products", "prediction_errors"]


TREES = {path: syntax(name) for name, path in MODULES.items()}


def room(path: Path) -> str:
    """Folder of the plan that holds a module, the innermost one."""
    place = path.relative_to(HOUSE)
    above = [place, *place.parents]
    return next((p.as_posix() for p in above if p.as_posix() in PLAN), place.parts[0])


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
    for path in TREES:
        place, names = path.relative_to(HOUSE).as_posix(), set(imported(path))
        needs = {room(MODULES[name]) for name in names & MODULES.keys() - {"testbed"}}
        if room(path) not in ANYWHERE:
            assert needs <= {room(path), *PLAN.get(room(path), "").split()}, (
                f"{place} imports {needs}"
            )
        for guest in {name.split(".")[0] for name in names}:
            assert guest not in FORBIDDEN, f"{place} imports {guest}"
            assert place.startswith(tuple(GUESTS.get(guest, place).split())), (place, guest)


def test_neither_rooms_nor_files_need_each_other_in_a_circle() -> None:
    assert stuck({name: set(needs.split()) for name, needs in PLAN.items()}) == set()
    needs = {name: MODULES.keys() & {*imported(p, types=False)} for name, p in MODULES.items()}
    inner = {name: wants - {name, "testbed"} for name, wants in needs.items() if name != "testbed"}
    assert stuck(inner) == set()


def test_every_room_is_in_the_plan_and_in_the_drawing() -> None:
    rooms = {room(path) for path in TREES} - ANYWHERE - {"core"}
    assert rooms == set(PLAN)
    drawing = (ROOT / "docs/architecture.md").read_text()
    assert [name for name in rooms if not re.search(rf"\b{name}\b", drawing)] == []


def is_estimator(path: Path) -> bool:
    place = path.relative_to(HOUSE).as_posix()
    rooms = ("core/estimation/", "bodies/consistency/", "applications/")
    return place.startswith(rooms) or place in {f"bodies/{name}.py" for name in ESTIMATORS}


def test_the_estimator_never_speaks_of_the_truth() -> None:
    """Nothing in it reads what only a simulation knows, or runs text as code."""
    for path in (path for path in TREES if is_estimator(path)):
        for node in ast.walk(TREES[path]):
            if isinstance(node, ast.Attribute):
                assert node.attr not in ("truth", "inertias", "pedestal", "coulomb"), path
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "barycentric", "standard"), path


def test_no_module_is_longer_than_a_person_reads() -> None:
    lengths = {path.relative_to(HOUSE): path.read_text().count("\n") for path in TREES}
    assert {name: lines for name, lines in lengths.items() if lines > LONGEST_MODULE} == {}


@pytest.mark.slow
def test_values_are_frozen_and_those_with_arrays_are_themselves_alone() -> None:
    """What others hold cannot change under them, and `==` has one answer."""
    for module in sorted(module_name(p) for p in TREES if p.name != "__main__.py"):
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
    for path, tree in TREES.items():
        targets = [t for n in tree.body if isinstance(n, ast.Assign) for t in n.targets]
        names = [x.id for t in targets for x in ast.walk(t) if isinstance(x, ast.Name)]
        assert len(set(names)) == len(names), path


def test_nothing_names_a_machine_or_a_registry() -> None:
    texts = [ROOT / name for name in ("README.md", "CHANGELOG.md", "pyproject.toml", ".ci/run")]
    texts += [*TREES, *(ROOT / "docs").glob("*.md"), *(ROOT / "experiments").rglob("*.*")]
    texts += list(ROOT.glob("*.lock"))
    for path in texts:
        found = re.search(r"/(work|root|home)/|\.\./shared|pypi\.|--index-url", path.read_text())
        assert not found, f"{path}: {found}"
