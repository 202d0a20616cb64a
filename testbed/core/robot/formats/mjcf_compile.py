"""Compilation of MuJoCo models without warnings, without missing meshes, within size limits."""

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
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.robot.asset_files import mjcf_references
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.parsing import capture_stderr, parse_decimals, read_xml
from testbed.core.robot.rigid_matter import inertia_flaw

MAX_BODIES, MAX_ELEMENTS = 5_000, 50_000
"""Largest numbers of bodies and of all elements, after replication and inclusion."""
MAX_HFIELD_CELLS = 10**7
"""Largest number of cells of a height field, rows times columns."""
MAX_RESERVED = 10**6
"""Largest value in <size>; MuJoCo limits memory itself."""
MAX_MESH_PARAMETER = 500
"""Largest resolution of a builtin mesh; the number of vertices grows with its square."""
MAX_FILE_DEPTH = 8
"""Largest nesting depth of included files."""
_BODY_TAGS = ("body", "composite", "flexcomp")
_REPLICATING_TAGS = ("replicate", "composite", "flexcomp")
"""Elements whose attribute `count` is the number of copies."""


@dataclass(frozen=True)
class _ModelSize:
    """Numbers of elements and bodies after replication and inclusion."""

    elements: int = 0
    bodies: int = 0

    def __add__(self, other: _ModelSize) -> _ModelSize:
        return _ModelSize(self.elements + other.elements, self.bodies + other.bodies)

    def __mul__(self, copies: int) -> _ModelSize:
        return _ModelSize(self.elements * copies, self.bodies * copies)


def check_mjcf_size(path: Path) -> None:
    """Check that an MJCF file, with included files and replicated elements, is within size limits.

    Raises:
        ModelError: The file includes itself or is too large; a file is not XML, or not UTF-8.
    """
    size = _SizeCounter(path).size(path, ())
    if size.elements > MAX_ELEMENTS or size.bodies > MAX_BODIES:
        raise ModelError(
            f"{path}: would become {_count_text(size.bodies)} bodies, {_count_text(size.elements)} "
            f"elements in all; {MAX_BODIES} and {MAX_ELEMENTS} are the limits (see "
            "<replicate>, <attach>, <include>)"
        )
    for _ in mjcf_references(path):  # raises an error for devices and pipes
        pass


class _SizeCounter:
    """Counter of elements and bodies in files that include each other."""

    def __init__(self, first: Path) -> None:
        self._first = first
        self._sizes: dict[Path, _ModelSize] = {}

    def size(self, path: Path, within: tuple[Path, ...]) -> _ModelSize:
        """Numbers of elements and bodies of a file and of its included files.

        Args:
            path: Model file.
            within: Files that include this file, outermost first.

        Raises:
            ModelError: The file includes itself, or files include each other more than
                MAX_FILE_DEPTH deep.
        """
        place = path.resolve()
        if place in within:
            raise ModelError(
                f"{self._first}: '{path.name}' holds itself, by <include> or <model>"
            )
        if len(within) >= MAX_FILE_DEPTH:
            raise ModelError(
                f"{self._first}: more than {MAX_FILE_DEPTH} files hold each other"
            )
        if place not in self._sizes:
            self._sizes[place] = self._count_elements(path, (*within, place))
        return self._sizes[place]

    def _count_elements(self, path: Path, within: tuple[Path, ...]) -> _ModelSize:
        """Count the elements and bodies of a file with all copies; check encoding and numbers.

        An <attach> element adds the size of the model that it names, or of the largest model of the
        file for an unknown name.

        Args:
            path: Model file.
            within: The files that include this file, outermost first, and this file.

        Raises:
            ModelError: The file is not UTF-8 or not XML, or a stated size exceeds a limit.
        """
        root = read_xml(path)
        try:
            path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise ModelError(
                f"{path}: not UTF-8, which is all that MuJoCo reads"
            ) from None
        models: dict[str, _ModelSize] = {}
        for model in root.iter("model"):
            model_size = self._included_size(model, path, within)
            models |= dict.fromkeys(
                (model.get("name", ""), Path(model.get("file", "")).stem), model_size
            )
        unnamed = max(
            models.values(), key=lambda size: size.elements, default=_ModelSize()
        )
        size = _ModelSize()
        for element, copies in _elements_with_copies(root):
            size += _ModelSize(1, element.tag in _BODY_TAGS) * copies
            if element.tag == "attach":
                size += models.get(element.get("model", ""), unnamed) * copies
            elif element.tag in ("include", "model"):
                size += self._included_size(element, path, within) * copies
            elif element.tag in ("hfield", "size", "mesh"):
                self._check_numbers(element)
        return size

    def _included_size(
        self, element: ET.Element, path: Path, within: tuple[Path, ...]
    ) -> _ModelSize:
        """Size of the file named by an element; zero if missing.

        Names are relative to the including file or to the first file; the larger size is used.

        Args:
            element: Element with the attribute `file`.
            path: File that contains the element.
            within: Files that include each other, outermost first.
        """
        name = element.get("file", "")
        places = [folder / name for folder in {path.parent, self._first.parent} if name]
        sizes = [self.size(place, within) for place in places if place.exists()]
        return max(sizes, key=lambda size: size.elements, default=_ModelSize())

    def _check_numbers(self, element: ET.Element) -> None:
        """Check sizes stated by a height field, a mesh or a <size> element.

        Raises:
            ModelError: A size exceeds MAX_HFIELD_CELLS, MAX_MESH_PARAMETER or MAX_RESERVED.
        """
        if element.tag == "hfield":
            if (
                _largest_number(element, "nrow") * _largest_number(element, "ncol")
                > MAX_HFIELD_CELLS
            ):
                raise ModelError(
                    f"{self._first}: a height field of more than {MAX_HFIELD_CELLS} cells"
                )
        elif element.tag == "mesh":
            if _largest_number(element, "params") > MAX_MESH_PARAMETER:
                raise ModelError(
                    f"{self._first}: a mesh of params above {MAX_MESH_PARAMETER}"
                )
        else:
            reserved = {
                key: _largest_number(element, key)
                for key in element.attrib
                if key != "memory"
            }
            large = [key for key, value in reserved.items() if value > MAX_RESERVED]
            if large:
                raise ModelError(
                    f"{self._first}: <size {large[0]}> reserves more than {MAX_RESERVED}"
                )


def _largest_number(element: ET.Element, key: str) -> float:
    """Largest magnitude among the numbers of an attribute; zero if there are none."""
    words = [parse_decimals(word, 1) for word in element.get(key, "").split()]
    return max((abs(word[0]) for word in words if word), default=0.0)


def _elements_with_copies(root: ET.Element) -> Iterator[tuple[ET.Element, int]]:
    """Yield the elements of a file, each with its number of copies.

    Copies come from enclosing elements with a tag in _REPLICATING_TAGS.
    """
    pending = [(root, 1)]
    while pending:
        element, copies = pending.pop()
        if element.tag in _REPLICATING_TAGS:
            counts = [
                parse_decimals(word, 1) for word in element.get("count", "1").split()
            ]
            copies *= prod(max(1, int(count[0])) for count in counts if count)
        yield element, copies
        pending += [(child, copies) for child in element]


def _count_text(number: int) -> str:
    """Text of a count; a power of ten for counts of ten digits or more."""
    return str(number) if number < 10**9 else f"over 10^{len(str(number)) - 1}"


MIN_COMPILED_MASS = 1e-12
"""Mass and inertia assigned to massless bodies for the compiler, and read back as zero
[kg, kg m^2]."""
FULLINERTIA_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of an inertia tensor's entries, in the order of MuJoCo's `fullinertia`."""


def compile_spec(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile a MuJoCo model; if that fails, drop unreadable meshes and compile again.

    Only meshes without effect on inertias are dropped.

    Args:
        spec: Editable model, changed in place if meshes are dropped.
        path: Model file, for messages.

    Raises:
        ModelError: MuJoCo rejects the model, or an unreadable mesh determines an inertia.
    """
    with suppress_mujoco_warnings():
        try:
            return spec.compile()
        except Exception as error:
            first = error_line(error)
        try:
            if drop_unreadable_meshes(spec, path):
                return spec.compile()
        except ValueError as error:
            first = error_line(error)
    raise ModelError(f"{path}: {first}")


def drop_unreadable_meshes(spec: mujoco.MjSpec, path: Path) -> tuple[Diagnostic, ...]:
    """Remove meshes that MuJoCo cannot compile, and their geoms, from a model.

    Args:
        spec: Editable model, changed in place.
        path: Model file, for messages.

    Returns:
        Diagnostics with the names of the meshes.

    Raises:
        ModelError: The inertia of a body comes from such a mesh.
    """
    diagnostics = []
    with suppress_mujoco_warnings():
        for mesh in list(spec.meshes):
            name, fault = mesh.name, _mesh_fault(spec, mesh.name)
            if fault is None:
                continue
            diagnostics.append(
                make_diagnostic("model.mesh", mesh.file or name, reason=fault)
            )
            for geom in [geom for geom in spec.geoms if geom.meshname == name]:
                body = geom.parent
                if not body.explicitinertial and body.name != "world":
                    raise ModelError(
                        f"{path}: the inertia of body '{body.name}' comes from its mesh, and "
                        f"{fault}"
                    )
                spec.delete(geom)
            spec.delete(mesh)
    return tuple(diagnostics)


def _mesh_fault(spec: mujoco.MjSpec, name: str) -> str | None:
    """MuJoCo's error message for a model with a single mesh; None if the mesh compiles."""
    mesh_spec = spec.copy()
    extract_explicit_inertias(mesh_spec)
    for geom in list(mesh_spec.geoms):
        if geom.meshname:
            mesh_spec.delete(geom)
    for mesh in list(mesh_spec.meshes):
        if mesh.name != name:
            mesh_spec.delete(mesh)
    try:
        mesh_spec.compile()
    except Exception as error:
        return error_line(error)
    return None


@contextmanager
def suppress_mujoco_warnings() -> Iterator[None]:
    """Suppress MuJoCo's warnings and standard error within a context.

    MuJoCo otherwise writes to the terminal and to MUJOCO_LOG.TXT.
    """
    with suppress_step_warnings(), capture_stderr(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def suppress_step_warnings() -> Iterator[None]:
    """Suppress MuJoCo's warnings during steps within a context; standard error is unchanged."""
    original_handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(original_handler)


@dataclass(frozen=True, eq=False)
class ExplicitInertia:
    """Explicit inertia of a body as stated in the file.

    MuJoCo's compiler loses digits when it computes principal axes.

    Attributes:
        mass: Mass [kg].
        moments: Inertia along the body's axes, (3, 3), or principal moments along the axes of the
            body's `iquat`, (3,) [kg m^2].
    """

    mass: float
    moments: Array


def extract_explicit_inertias(
    spec: mujoco.MjSpec,
) -> tuple[dict[str, str], dict[str, ExplicitInertia]]:
    """Flaws of inconsistent inertias, and explicit inertias as in the file, keyed by body name.

    Inconsistent inertias in `spec` are replaced by 1 kg and 1 kg m^2, so that the model compiles.
    Both results are empty if the compiler computes all inertias from geoms or balances them.
    """
    spec.compiler.boundmass = spec.compiler.boundinertia = MIN_COMPILED_MASS
    flaws: dict[str, str] = {}
    stated: dict[str, ExplicitInertia] = {}
    compiler = spec.compiler
    from_geoms = (
        compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    )
    if from_geoms or compiler.balanceinertia:
        return flaws, stated  # inertias come from the compiler
    for body in spec.bodies:
        if not body.explicitinertial:
            continue
        mass, full = body.mass, None
        if not np.isnan(body.fullinertia[0]):
            full = np.empty((3, 3))
            for value, (a, b) in zip(
                body.fullinertia, FULLINERTIA_ENTRIES, strict=True
            ):
                full[a, b] = full[b, a] = value
        flaw = inertia_flaw(
            body.name, mass, np.diag(body.inertia) if full is None else full
        )
        if not np.isfinite(body.ipos).all():
            flaw = f"link '{body.name}' has a mass centre that is not a number"
            body.ipos, mass = np.zeros(3), np.nan
        stated[body.name] = ExplicitInertia(
            mass, np.array(body.inertia) if full is None else full
        )
        if flaw:
            flaws[body.name] = flaw
            body.mass, body.inertia, body.fullinertia = (
                1.0,
                np.ones(3),
                np.full(6, np.nan),
            )
    return flaws, stated


def set_inertia(body: mujoco.MjsBody, inertia: Inertia) -> None:
    """Replace the inertia of an editable body by `inertia`, relative to the body's frame."""
    central = inertia.central
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat = inertia.mass, inertia.com, [1.0, 0.0, 0.0, 0.0]
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.inertia = np.zeros(3)
    body.fullinertia = (
        [central[at] for at in FULLINERTIA_ENTRIES]
        if central.any()
        else np.full(6, np.nan)
    )


def compile_copy(
    spec: mujoco.MjSpec, path: Path
) -> tuple[mujoco.MjModel, dict[str, ExplicitInertia]]:
    """Compiled copy of a model, and explicit inertias of the file keyed by body.

    Compilation resolves frames, angle units, limits and masses.

    Args:
        spec: Editable model, unchanged.
        path: Model file, for messages.
    """
    copy = spec.copy()
    _, stated = extract_explicit_inertias(copy)
    return compile_spec(copy, path), stated


def error_line(error: Exception) -> str:
    """Message of a MuJoCo error on one line, of at most 400 characters."""
    # MuJoCo quotes text of the file
    return " ".join(str(error).removeprefix("Error: ").split())[:400]


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrix of a quaternion (w, x, y, z), (3, 3)."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)
