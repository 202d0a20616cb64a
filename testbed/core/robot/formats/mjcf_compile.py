"""MuJoCo's compiler: kept quiet, without meshes that are missing, within bounds of size."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError
from testbed.core.robot.asset_files import mjcf_files
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.parsing import capture_stderr, decimals, read_xml
from testbed.core.robot.rigid_matter import inertia_flaw

MOST_MADE_BODIES, MOST_MADE_ELEMENTS = 5_000, 50_000
"""Bodies, and elements of all kinds, that a file may become, copies counted."""
MOST_CELLS = 10**7
"""Of a height field: rows times columns."""
MOST_RESERVED = 10**6
"""Of anything that <size> reserves, memory aside, which MuJoCo bounds itself."""
FINEST_MESH = 500
"""Largest parameter of a mesh that MuJoCo makes: its resolution, squared in vertices."""
DEEPEST_FILES = 8
"""Files that may hold each other in a row."""
_BODIES = ("body", "composite", "flexcomp")
_COPIED = ("replicate", "composite", "flexcomp")
"""Elements whose attribute `count` says how many copies are made."""


@dataclass(frozen=True)
class _Size:
    """How many elements and bodies something becomes."""

    elements: int = 0
    bodies: int = 0

    def __add__(self, other: _Size) -> _Size:
        return _Size(self.elements + other.elements, self.bodies + other.bodies)

    def __mul__(self, copies: int) -> _Size:
        return _Size(self.elements * copies, self.bodies * copies)


def check_files(path: Path) -> None:
    """Whether a file, with all that it includes, attaches and copies, is of a size to be read.

    Raises:
        ModelError: It holds itself, or becomes too large; a file is not XML, or not UTF-8.
    """
    made = _Files(path).size(path, ())
    if made.elements > MOST_MADE_ELEMENTS or made.bodies > MOST_MADE_BODIES:
        raise ModelError(
            f"{path}: would become {_rounded(made.bodies)} bodies, {_rounded(made.elements)} "
            f"elements in all; {MOST_MADE_BODIES} and {MOST_MADE_ELEMENTS} are the limits (see "
            "<replicate>, <attach>, <include>)"
        )
    for _ in mjcf_files(path):  # refuses what cannot be read to an end
        pass


class _Files:
    """Model files that hold each other, each read and counted once."""

    def __init__(self, first: Path) -> None:
        self._first = first
        self._counted: dict[Path, _Size] = {}

    def size(self, path: Path, within: tuple[Path, ...]) -> _Size:
        """What a file becomes.

        Args:
            path: The file.
            within: The files that hold it, outermost first.
        """
        place = path.resolve()
        if place in within:
            raise ModelError(
                f"{self._first}: '{path.name}' holds itself, by <include> or <model>"
            )
        if len(within) >= DEEPEST_FILES:
            raise ModelError(
                f"{self._first}: more than {DEEPEST_FILES} files hold each other"
            )
        if place not in self._counted:
            self._counted[place] = self._count(path, (*within, place))
        return self._counted[place]

    def _count(self, path: Path, within: tuple[Path, ...]) -> _Size:
        root = read_xml(path)
        try:
            path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise ModelError(
                f"{path}: not UTF-8, which is all that MuJoCo reads"
            ) from None
        models: dict[str, _Size] = {}
        for model in root.iter("model"):
            found = self._held(model, path, within)
            models |= dict.fromkeys(
                (model.get("name", ""), Path(model.get("file", "")).stem), found
            )
        unnamed = max(models.values(), key=lambda size: size.elements, default=_Size())
        made = _Size()
        for element, copies in _copies(root):
            made += _Size(1, element.tag in _BODIES) * copies
            if element.tag == "attach":
                made += models.get(element.get("model", ""), unnamed) * copies
            elif element.tag in ("include", "model"):
                made += self._held(element, path, within) * copies
            elif element.tag in ("hfield", "size", "mesh"):
                self._check_numbers(element)
        return made

    def _held(self, element: ET.Element, path: Path, within: tuple[Path, ...]) -> _Size:
        """What the file becomes that an element names, beside its own or the first one."""
        name = element.get("file", "")
        places = [folder / name for folder in {path.parent, self._first.parent} if name]
        sizes = [self.size(place, within) for place in places if place.exists()]
        return max(sizes, key=lambda size: size.elements, default=_Size())

    def _check_numbers(self, element: ET.Element) -> None:
        """Whether what an element's numbers ask for can be made in a moment."""
        if element.tag == "hfield":
            if _largest(element, "nrow") * _largest(element, "ncol") > MOST_CELLS:
                raise ModelError(
                    f"{self._first}: a height field of more than {MOST_CELLS} cells"
                )
        elif element.tag == "mesh":
            if _largest(element, "params") > FINEST_MESH:
                raise ModelError(f"{self._first}: a mesh of params above {FINEST_MESH}")
        else:
            reserved = {
                key: _largest(element, key) for key in element.attrib if key != "memory"
            }
            large = [key for key, value in reserved.items() if value > MOST_RESERVED]
            if large:
                raise ModelError(
                    f"{self._first}: <size {large[0]}> reserves more than {MOST_RESERVED}"
                )


def _largest(element: ET.Element, key: str) -> float:
    """The largest number of an attribute; zero where there is none."""
    words = [decimals(word, 1) for word in element.get(key, "").split()]
    return max((abs(word[0]) for word in words if word), default=0.0)


def _copies(root: ET.Element) -> Iterator[tuple[ET.Element, int]]:
    """All elements, and how many times each is made."""
    waiting = [(root, 1)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag in _COPIED:
            counts = [decimals(word, 1) for word in element.get("count", "1").split()]
            copies *= prod(max(1, int(count[0])) for count in counts if count)
        yield element, copies
        waiting += [(child, copies) for child in element]


def _rounded(number: int) -> str:
    return str(number) if number < 10**9 else f"over 10^{len(str(number)) - 1}"


MASSLESS = 1e-12
"""Given to massless bodies so that the compiler takes them; read back as no matter [kg]."""
FULL = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of an inertia in MuJoCo's order."""


def compile_spec(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile; where meshes cannot be read, without those that are only for the eye.

    Raises:
        ModelError: MuJoCo refuses the model.
    """
    with no_mujoco_warnings():
        try:
            return spec.compile()
        except Exception as error:
            first = one_line(error)
        try:
            if drop_unreadable_meshes(spec, path):
                return spec.compile()
        except ValueError as error:
            first = one_line(error)
    raise ModelError(f"{path}: {first}")


def drop_unreadable_meshes(spec: mujoco.MjSpec, path: Path) -> tuple[Diagnostic, ...]:
    """Take out meshes that MuJoCo cannot read, and the geoms made of them; names them.

    Raises:
        ModelError: The inertia of a body comes from such a mesh.
    """
    said = []
    with no_mujoco_warnings():
        for mesh in list(spec.meshes):
            name, fault = mesh.name, _mesh_fault(spec, mesh.name)
            if fault is None:
                continue
            said.append(diagnose("model.mesh", mesh.file or name, reason=fault))
            for geom in [geom for geom in spec.geoms if geom.meshname == name]:
                body = geom.parent
                if not body.explicitinertial and body.name != "world":
                    raise ModelError(
                        f"{path}: the inertia of body '{body.name}' comes from its mesh, and "
                        f"{fault}"
                    )
                spec.delete(geom)
            spec.delete(mesh)
    return tuple(said)


def _mesh_fault(spec: mujoco.MjSpec, name: str) -> str | None:
    """What MuJoCo says of one mesh; None if it can read it."""
    alone = spec.copy()
    stated_inertias(alone)
    for geom in list(alone.geoms):
        if geom.meshname:
            alone.delete(geom)
    for mesh in list(alone.meshes):
        if mesh.name != name:
            alone.delete(mesh)
    try:
        alone.compile()
    except Exception as error:
        return one_line(error)
    return None


@contextmanager
def no_mujoco_warnings() -> Iterator[None]:
    """MuJoCo's warnings go nowhere: neither to the terminal nor to MUJOCO_LOG.TXT."""
    with unwarned_steps(), capture_stderr(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def unwarned_steps() -> Iterator[None]:
    """The same for what MuJoCo says while it steps; standard error stays as it is."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@dataclass(frozen=True, eq=False)
class StatedInertia:
    """An inertia as the file states it: the compiler's principal axes cost digits."""

    mass: float
    moments: (
        Array  # (3, 3) along the body's axes, or (3,) along those given by its `iquat`
    )


def stated_inertias(
    spec: mujoco.MjSpec,
) -> tuple[dict[str, str], dict[str, StatedInertia]]:
    """Flaws and explicit inertias, by body; `spec` is made to compile: flawed ones are replaced."""
    spec.compiler.boundmass = spec.compiler.boundinertia = MASSLESS
    flaws: dict[str, str] = {}
    stated: dict[str, StatedInertia] = {}
    compiler = spec.compiler
    from_geoms = (
        compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    )
    if from_geoms or compiler.balanceinertia:
        return flaws, stated  # what counts is what the compiler makes of the file
    for body in spec.bodies:
        if not body.explicitinertial:
            continue
        mass, full = body.mass, None
        if not np.isnan(body.fullinertia[0]):
            full = np.empty((3, 3))
            for value, (a, b) in zip(body.fullinertia, FULL, strict=True):
                full[a, b] = full[b, a] = value
        found = inertia_flaw(
            body.name, mass, np.diag(body.inertia) if full is None else full
        )
        if not np.isfinite(body.ipos).all():
            found = f"link '{body.name}' has a mass centre that is not a number"
            body.ipos, mass = np.zeros(3), np.nan
        stated[body.name] = StatedInertia(
            mass, np.array(body.inertia) if full is None else full
        )
        if found:
            flaws[body.name] = found
            body.mass, body.inertia, body.fullinertia = (
                1.0,
                np.ones(3),
                np.full(6, np.nan),
            )
    return flaws, stated


def set_inertia(body: mujoco.MjsBody, inertia: Inertia) -> None:
    """Give a body another inertia, along its own axes."""
    central = inertia.central
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat = inertia.mass, inertia.com, [1.0, 0.0, 0.0, 0.0]
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.inertia = np.zeros(3)
    body.fullinertia = (
        [central[at] for at in FULL] if central.any() else np.full(6, np.nan)
    )


def resolve(
    spec: mujoco.MjSpec, path: Path
) -> tuple[mujoco.MjModel, dict[str, StatedInertia]]:
    """A copy compiled, for frames, degrees, limits and masses; and inertias as stated, by body."""
    copy = spec.copy()
    _, stated = stated_inertias(copy)
    return compile_spec(copy, path), stated


def one_line(error: Exception) -> str:
    """MuJoCo's message without its line breaks."""
    # of MuJoCo's: it repeats what it found in a file
    return " ".join(str(error).removeprefix("Error: ").split())[:400]


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrix of a quaternion (w, x, y, z), (3, 3)."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)
