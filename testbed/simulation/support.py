"""Effects of what the plate stands on: a bedplate that gives way, a floor that is not level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.kind_table import key
from testbed.robot.formats.mjcf_compile import no_mujoco_warnings
from testbed.robot.rotations import about
from testbed.robot.tree import Tree
from testbed.simulation.effect import PLATE_FREEDOM, Effect
from testbed.simulation.plant import Plant

SAME = 1e-6
"""Largest relative departure of frequencies and angles from what was asked for."""

_FREEDOMS = tuple(f"{PLATE_FREEDOM}{kind}{axis}" for kind in "tr" for axis in "xyz")


@dataclass(frozen=True, eq=False)
class CompliantPlate(Effect):
    """A bedplate on springs: three that let it shift, three that let it turn about its origin.

    Each is as stiff as the frequency wants, for the robot with all its joints at zero.

    Source    Our own choice: plates with strain gauges under robots of 60 kg, 60 to 200 Hz.

    Attributes:
        frequency: Of each spring with the robot on it [Hz].
        damping: Of each, as a ratio to critical damping.
    """

    kind: ClassVar[str] = "compliant_plate"
    frequency: float = key(200.0, positive=True)
    damping: float = key(0.02, least=0, most=10)

    def disturb(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Six joints between world and plate.

        Raises:
            SettingsError: They are there already.
        """
        del prefix
        if any(joint.name == _FREEDOMS[0] for joint in spec.joints):
            raise SettingsError(f"{self.kind}: the bedplate is on springs already; once is enough")
        site = next(s.objname for s in spec.sensors if s.type == mujoco.mjtSensor.mjSENS_FORCE)
        plate = spec.site(site).parent
        place = np.asarray(spec.site(site).pos)
        kinds = [mujoco.mjtJoint.mjJNT_SLIDE] * 3 + [mujoco.mjtJoint.mjJNT_HINGE] * 3
        springs = [
            plate.add_joint(name=name, type=kind, axis=axis, pos=place)
            for name, kind, axis in zip(_FREEDOMS, kinds, [*np.eye(3)] * 2, strict=True)
        ]
        with no_mujoco_warnings():
            model = spec.compile()
        pulse = 2 * np.pi * self.frequency
        for spring, inertia in zip(springs, _inertias(model), strict=True):
            spring.stiffness = _first(spring.stiffness, inertia * pulse**2)
            spring.damping = _first(spring.damping, 2 * self.damping * inertia * pulse)

    def flaw(self, plant: Plant, tree: Tree) -> str | None:
        """Whether each spring alone has its frequency, by the force of a small shift."""
        data, model = mujoco.MjData(plant.model), plant.model
        at = [int(model.joint(name).qposadr[0]) for name in _FREEDOMS]
        data.qpos[at] = shift = 1e-6
        mujoco.mj_forward(model, data)
        stiffness = -data.qfrc_passive[[int(model.joint(n).dofadr[0]) for n in _FREEDOMS]] / shift
        found = np.sqrt(stiffness / _inertias(model)) / (2 * np.pi)
        if np.abs(found / self.frequency - 1).max() <= SAME:
            return None
        return f"the bedplate's springs have {found} Hz, not {self.frequency:g}"


@dataclass(frozen=True, eq=False)
class Tilt(Effect):
    """A bedplate that is not level: gravity is turned against what recordings say.

    Source    Our own choice: 0.2 degrees, a spirit level's.

    Attributes:
        angle: Of gravity against the z axis [rad].
        direction: Of the horizontal axis about which gravity is turned, from x [rad].
    """

    kind: ClassVar[str] = "tilt"
    angle: float = key(3.5e-3, least=-1.5, most=1.5)
    direction: float = key(0.0)

    def disturb(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Gravity of another direction."""
        del prefix
        axis = np.array([np.cos(self.direction), np.sin(self.direction), 0.0])
        spec.option.gravity = about(axis, self.angle) @ tree.gravity

    def flaw(self, plant: Plant, tree: Tree) -> str | None:
        """Whether gravity has kept its size and makes the angle with what it was, at most."""
        was, now = tree.gravity, plant.model.opt.gravity
        size = float(np.linalg.norm(was))
        moved = float(np.linalg.norm(now - was))
        most = 2 * np.sin(abs(self.angle) / 2) * size
        if abs(np.linalg.norm(now) - size) <= SAME * size and moved <= most * (1 + SAME):
            return None
        return f"gravity is {now}, turned from {was} by more than {self.angle:g} rad"


def _inertias(model: mujoco.MjModel) -> Array:
    """What each freedom of the plate moves, all joints at zero, (6,) [kg, kg m^2]."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    found: Array = np.diagonal(matrix)[[int(model.joint(n).dofadr[0]) for n in _FREEDOMS]]
    return found


def _first(values: Array, value: float) -> Array:
    """A coefficient where MuJoCo takes polynomials."""
    found = np.zeros(np.size(values))
    found[0] = value
    return found
