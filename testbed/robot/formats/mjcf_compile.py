"""MuJoCo's compiler: kept quiet, helped over missing meshes and impossible inertias."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.errors import ModelError
from testbed.robot.inertia import Inertia, inertia_flaw
from testbed.robot.parsing import capture_stderr

LONGEST_MESSAGE = 400
"""Of MuJoCo's: it repeats what it found in a file."""
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
    moments: Array  # (3, 3) along the body's axes, or (3,) along those given by its `iquat`


def stated_inertias(spec: mujoco.MjSpec) -> tuple[dict[str, str], dict[str, StatedInertia]]:
    """Flaws and explicit inertias, by body; `spec` is made to compile: flawed ones are replaced."""
    spec.compiler.boundmass = spec.compiler.boundinertia = MASSLESS
    flaws: dict[str, str] = {}
    stated: dict[str, StatedInertia] = {}
    compiler = spec.compiler
    from_geoms = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
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
        found = inertia_flaw(body.name, mass, np.diag(body.inertia) if full is None else full)
        if not np.isfinite(body.ipos).all():
            found = f"link '{body.name}' has a mass centre that is not a number"
            body.ipos, mass = np.zeros(3), np.nan
        stated[body.name] = StatedInertia(mass, np.array(body.inertia) if full is None else full)
        if found:
            flaws[body.name] = found
            body.mass, body.inertia, body.fullinertia = 1.0, np.ones(3), np.full(6, np.nan)
    return flaws, stated


def set_inertia(body: mujoco.MjsBody, inertia: Inertia) -> StatedInertia:
    """Give a body another inertia, along its own axes."""
    central = inertia.central
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat = inertia.mass, inertia.com, [1.0, 0.0, 0.0, 0.0]
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.inertia = np.zeros(3)
    body.fullinertia = [central[at] for at in FULL] if central.any() else np.full(6, np.nan)
    return StatedInertia(inertia.mass, central)


def resolve(spec: mujoco.MjSpec, path: Path) -> tuple[mujoco.MjModel, dict[str, StatedInertia]]:
    """A copy compiled, for frames, degrees, limits and masses; and inertias as stated, by body."""
    copy = spec.copy()
    _, stated = stated_inertias(copy)
    return compile_spec(copy, path), stated


def one_line(error: Exception) -> str:
    """MuJoCo's message without its line breaks."""
    return " ".join(str(error).removeprefix("Error: ").split())[:LONGEST_MESSAGE]
