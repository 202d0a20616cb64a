"""The house keeps its plan: imports go upstream, guests stay in their rooms, modules stay small."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import testbed as tb
from tests.helpers.paths import ROOT

HOUSE = ROOT / "testbed"
MODULES = sorted(HOUSE.rglob("*.py"))

# What a room may import, besides itself. docs/architecture.md draws the same plan.
BASE = {"errors", "arrays", "files", "blas"}
KINDS = {"keys", "kind_table", "kind_words"}
PLAN = {
    "errors": set(),
    "arrays": set(),
    "files": set(),
    "blas": set(),
    "installation": set(),
    "keys": {"errors"},
    "kind_table": {"errors", "arrays", "keys"},
    "kind_words": {"kind_table"},
    "toml_text": {"errors"},
    "robot": BASE,
    "parameters": BASE | {"robot"},
    "dynamics": BASE | {"robot", "parameters"},
    "kernel": BASE | {"robot", "parameters", "dynamics"},
    "symbolic": BASE | {"robot", "parameters", "dynamics"},
    "excitation": BASE | {"robot", "parameters", "dynamics", "kernel"},
    "recordings": BASE | {"toml_text", "robot"},
    "instruments": BASE | KINDS | {"robot", "recordings"},
    "simulation": BASE | KINDS | {"robot", "dynamics", "excitation", "recordings"},
    "identification": BASE | {"robot", "parameters", "dynamics", "kernel", "recordings"},
    "sanity": BASE
    | {"toml_text", "robot", "parameters", "dynamics", "recordings", "identification"},
    "experiment": BASE
    | KINDS
    | {
        "installation", "toml_text", "robot", "parameters", "dynamics", "excitation", "recordings",
        "instruments", "simulation", "identification",
    },
    "campaign": BASE
    | {"toml_text", "robot", "recordings", "identification", "experiment"},
    "reporting": BASE
    | {
        "robot", "parameters", "dynamics", "excitation", "recordings", "identification", "sanity",
        "experiment", "campaign",
    },
    "viewer": BASE
    | {
        "robot", "parameters", "dynamics", "excitation", "recordings", "identification",
        "experiment", "campaign",
    },
}  # fmt: skip
ANYWHERE = {"__init__", "__main__", "cli"}

# Packages that only some modules may import.
GUESTS = {
    "mujoco": (
        "robot/formats/mjcf",
        "robot/formats/write_mjcf.py",
        "robot/visuals/mjcf_shapes.py",
        "simulation/",
        "excitation/collision_model.py",
        "excitation/clearance.py",
    ),
    "pinocchio": ("robot/formats/urdf.py", "robot/visuals/urdf_shapes.py"),
    "coal": ("robot/visuals/urdf_shapes.py",),
    "rerun": ("viewer/",),
    "clarabel": ("identification/conic.py",),
    "numba": ("kernel/",),
    "llvmlite": ("kernel/compiler.py",),
    "threadpoolctl": ("blas.py",),
    "pyarrow": (
        "recordings/formats/parquet.py",
        "recordings/importing/readers/parquet_columns.py",
        "campaign/",
    ),
    "distributed": ("campaign/cluster.py",),
    "dask": ("campaign/cluster.py",),
    "h5py": ("recordings/importing/readers/hdf5.py",),
    "rosbags": ("recordings/importing/readers/ros_bag.py",),
    "pydantic": ("experiment/", "campaign/", "recordings/importing/mapping.py", "toml_text.py"),
    "tomli_w": ("experiment/", "campaign/campaign_folder.py"),
    "typer": ("cli/",),
    "rich": ("reporting/",),
    "matplotlib": ("reporting/figures.py", "reporting/error_dots.py", "reporting/plot.py"),
    "jinja2": ("reporting/html.py",),
    "markupsafe": ("reporting/html.py",),
    "subprocess": ("viewer/show.py",),  # Rerun's viewer, and nothing else
}
FORBIDDEN = ("pickle", "shelve", "marshal", "requests", "urllib", "http")
LONGEST_MODULE = 500
LONGEST_FUNCTION = 45  # statements and comments; signature and docstring aside


def room(path: Path) -> str:
    return path.relative_to(HOUSE).parts[0].removesuffix(".py")


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            yield node.module or ""


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(HOUSE)))
def test_imports_go_upstream_only(path: Path) -> None:
    here = room(path)
    if here in ANYWHERE:
        return
    for name in imports(path):
        if name.startswith("testbed."):
            there = name.split(".")[1]
            assert there == here or there in PLAN[here], f"{path} imports {name}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(HOUSE)))
def test_guests_stay_in_their_rooms(path: Path) -> None:
    place = str(path.relative_to(HOUSE))
    for name in imports(path):
        package = name.split(".")[0]
        assert package not in FORBIDDEN, f"{place} imports {name}"
        if package in GUESTS:
            assert place.startswith(GUESTS[package]), f"{place} imports {name}"


def test_the_plan_has_no_circle() -> None:
    seen: list[str] = []
    while len(seen) < len(PLAN):
        ready = [r for r, needs in PLAN.items() if r not in seen and needs <= set(seen)]
        assert ready, f"rooms in a circle: {set(PLAN) - set(seen)}"
        seen += ready


def needs(path: Path) -> set[str]:
    """The project's own modules that a module imports, lazily or not; types alone aside."""
    found = set()
    for node in ast.walk(without_type_checking(ast.parse(path.read_text()))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found & set(NAMES)


def without_type_checking(tree: ast.Module) -> ast.Module:
    kept = [
        node
        for node in tree.body
        if not (
            isinstance(node, ast.If)
            and isinstance(node.test, ast.Name)
            and node.test.id == "TYPE_CHECKING"
        )
    ]
    return ast.Module(kept, [])


def module_name(path: Path) -> str:
    parts = path.relative_to(HOUSE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


NAMES = {module_name(path): path for path in MODULES}


@pytest.mark.slow
def test_no_files_import_each_other_in_a_circle() -> None:
    graph = {name: needs(path) - {name} for name, path in NAMES.items() if name != "testbed"}
    done: set[str] = {"testbed"}
    while len(done) <= len(graph):
        ready = [name for name, wants in graph.items() if name not in done and wants <= done]
        left = sorted(set(graph) - done)
        assert ready, f"files in a circle, or behind one: {left}"
        done |= set(ready)


def test_file_names_tell_files_apart() -> None:
    """A name stands once in the house, but for formats' readers and the rooms' own heads."""
    names = [path.name for path in MODULES if path.name not in ("__init__.py", "__main__.py")]
    assert sorted(set(names)) == sorted(names)


def test_every_room_is_in_the_plan_and_in_the_drawing() -> None:
    rooms = {room(path) for path in MODULES} - ANYWHERE
    assert rooms == set(PLAN)
    drawing = (ROOT / "docs/architecture.md").read_text()
    for name in rooms:
        assert re.search(rf"\b{name}\b", drawing), f"docs/architecture.md does not show {name}"


def test_the_estimator_never_speaks_of_the_truth() -> None:
    for path in (HOUSE / "identification").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute):
                assert node.attr not in ("truth", "inertias", "pedestal", "coulomb"), path
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "barycentric", "standard"), path


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(HOUSE)))
def test_modules_and_functions_fit_a_screen(path: Path) -> None:
    text = path.read_text()
    assert text.count("\n") <= LONGEST_MODULE
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            first = node.body[1] if ast.get_docstring(node) and len(node.body) > 1 else node.body[0]
            length = (node.end_lineno or 0) - first.lineno + 1
            assert length <= LONGEST_FUNCTION, f"{path.name}: {node.name} has {length} lines"


def test_what_is_promised_is_there_and_nothing_else() -> None:
    tree = ast.parse((HOUSE / "__init__.py").read_text())
    typed = {
        (node.module, alias.name)
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    lazy = {(home, name) for home, names in tb._HOMES.items() for name in names}
    assert typed == lazy
    for name in tb.__all__:
        assert getattr(tb, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = tb.nothing


def test_every_reference_resolves() -> None:
    known = set(re.findall(r"@\w+\{(\w+),", (ROOT / "REFERENCES.bib").read_text()))
    for path in [*MODULES, *(ROOT / "docs").glob("*.md"), ROOT / "README.md"]:
        for key in re.findall(r"\[([A-Z][A-Za-z]{1,4}\d{2})\]", path.read_text()):
            assert key in known, f"{path}: [{key}] is not in REFERENCES.bib"


def test_nothing_names_a_machine_or_a_registry() -> None:
    texts = [ROOT / name for name in ("README.md", "CHANGELOG.md", "pyproject.toml", ".ci/run")]
    texts += [*MODULES, *(ROOT / "docs").glob("*.md"), *(ROOT / "experiments").rglob("*.*")]
    texts += list(ROOT.glob("*.lock"))
    for path in texts:
        found = re.search(r"/(work|root|home)/|\.\./shared|pypi\.|--index-url", path.read_text())
        assert not found, f"{path}: {found}"
