"""Effects that are bodies: a payload on a link, a drive's rotor that spins on its carrier."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

import mujoco
import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.base.transform import Transform
from testbed.core.parameters.rules import across
from testbed.core.robot.formats.mjcf_compile import no_mujoco_warnings
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.rotations import from_vector, to_quaternion
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import Effect
from testbed.sensors.kind_table import PerAxis, PerJoint, each_joint

MASSLESS = 1e-9
"""Mass of a body of which only the inertia counts [kg]: MuJoCo needs one."""


@dataclass(frozen=True, eq=False)
class Payload(Effect):
    """A body fixed to a link, as a tool or a load at the flange; a part of the robot's truth.

    Source    Our own choice: 1 kg, a sphere of 7 cm.

    Attributes:
        joint: The link is the one that this joint moves; "" for the last.
        mass: [kg].
        centre: Of mass, in the frame of the joint's body, one for x, y and z or three [m].
        inertia: About the centre, likewise [kg m^2].
    """

    kind: ClassVar[str] = "payload"
    joint: str = ""
    mass: Annotated[float, Gt(0)] = 1.0
    centre: PerAxis = 0.05
    inertia: Annotated[PerAxis, Gt(0)] = 2e-3

    @property
    def body(self) -> Inertia:
        """In the frame of the joint's body."""
        centre, moments = (np.broadcast_to(v, 3) for v in (self.centre, self.inertia))
        return Inertia.about_centre(self.mass, centre, np.diag(moments))

    def robot(self, tree: Tree) -> Tree:
        """The robot with the payload."""
        if self.joint and self.joint not in tree.names:
            raise SettingsError(
                f"payload: {UnknownName('joint', self.joint, tree.names)}"
            )
        return tree.with_inertia(self._link(tree), self.body)

    def equip(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """A body of MuJoCo's, welded to the link."""
        link = self._link(tree)
        body = spec.joint(prefix + tree.names[link]).parent
        centre, moments = (np.broadcast_to(v, 3) for v in (self.centre, self.inertia))
        X_LC = Transform(p_AB_A=centre)
        _weld(spec, body, "testbed/payload", tree, link, X_LC, self.mass, moments)

    def _link(self, tree: Tree) -> int:
        return tree.index(self.joint) if self.joint else tree.n - 1


@dataclass(frozen=True, eq=False)
class GearedRotor(Effect):
    """A rotor that the carrying link holds and that turns so many times faster than its joint.

    Its angular momentum reaches the plate: ratio inertia d(qd e)/dt, which is what a joint body
    of that much more inertia about the axis e would add, and a carrier of that much less. The
    model file's own rotor inertia stays beside it. Turning joints only.

    Source    [AKB86]: a PUMA's waist, 1.14 kg m^2 at the joint by a ratio of 62.6.

    Attributes:
        inertia: Of the rotor about its axis [kg m^2].
        ratio: Turns of the rotor a turn of the joint.
    """

    kind: ClassVar[str] = "geared_rotor"
    inertia: Annotated[PerJoint, Ge(0)] = 2e-4
    ratio: PerJoint = 60.0

    def robot(self, tree: Tree) -> Tree:
        """The carriers with the rotors at rest on them, the joints with what their spin takes."""
        for joint, inertia, ratio in self._each(tree):
            if not tree.joints[joint].revolute:
                raise SettingsError(
                    f"geared_rotor: joint '{tree.names[joint]}' slides; give inertia by joint name"
                )
            known = tree.joints[joint]
            axis = known.carried_axis
            still = inertia / 2 * (np.eye(3) + np.outer(axis, axis))
            tree = tree.with_inertia(known.parent, Inertia(0.0, np.zeros(3), still))
            reflected = known.rotor_inertia + ratio**2 * inertia
            tree = tree.with_joints({known.name: {"rotor_inertia": reflected}})
        return tree

    def equip(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """The rotors at rest on their carriers, and what their spin takes."""
        for joint, inertia, _ in self._each(tree):
            known = tree.joints[joint]
            hinge, moments = (
                spec.joint(prefix + known.name),
                inertia * np.array([0.5, 0.5, 1.0]),
            )
            frame = tree, joint, Transform(across(known.axis).R_BT)
            _weld(
                spec, hinge.parent.parent, _rotor(known.name), *frame, MASSLESS, moments
            )
            hinge.armature = known.rotor_inertia

    def disturb(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Rotors that turn."""
        step = spec.option.timestep
        for joint, inertia, ratio in self._each(tree):
            name = prefix + tree.names[joint]
            rotor = _rotor(tree.names[joint])
            spec.body(rotor).add_joint(
                name=rotor, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1]
            )
            spec.joint(name).armature -= ratio**2 * inertia
            gear = spec.add_equality(name=rotor, type=mujoco.mjtEq.mjEQ_JOINT)
            gear.objtype = mujoco.mjtObj.mjOBJ_JOINT
            gear.name1, gear.name2 = rotor, name
            gear.data[:5] = [0.0, ratio, 0.0, 0.0, 0.0]
            gear.solref, gear.solimp = [2 * step, 1], [0.9999, 0.9999, 0.001, 0.5, 2]

    def _each(self, tree: Tree) -> Iterator[tuple[int, float, float]]:
        """Joint, inertia and ratio where there is a rotor."""
        sizes, ratios = (
            np.broadcast_to(each_joint(value), tree.n)
            for value in (self.inertia, self.ratio)
        )
        for joint, (inertia, ratio) in enumerate(zip(sizes, ratios, strict=True)):
            if inertia and ratio:
                yield joint, float(inertia), float(ratio)


def _rotor(joint: str) -> str:
    return f"testbed/rotor/{joint}"


def _weld(
    spec: mujoco.MjSpec,
    to: mujoco.MjsBody,
    name: str,
    tree: Tree,
    link: int,
    X_LC: Transform,
    mass: float,
    moments: Array,
) -> None:
    """Fix a body to one of MuJoCo's.

    Args:
        spec: The robot.
        to: Body of MuJoCo's.
        name: Of the new body.
        tree: The robot.
        link: Index of the joint whose body is frame L, all joints at zero.
        X_LC: Pose of the principal axes about the centre of mass, C, in L.
        mass: [kg].
        moments: Principal moments of inertia, (3,) [kg m^2].
    """
    here = _at_zero(spec)[1].body(to.name)
    X_WT = Transform(here.xmat.reshape(3, 3), here.xpos)
    X_TC = X_WT.inverse @ tree.zero_poses[link] @ X_LC
    to.add_body(
        name=name,
        pos=X_TC.p_AB_A,
        quat=to_quaternion(X_TC.R_AB),
        mass=mass,
        ipos=np.zeros(3),  # which is `pos` where it is left out
        iquat=[1.0, 0.0, 0.0, 0.0],
        inertia=moments,
        explicitinertial=True,
    )


_FREEDOMS = tuple(f"testbed/plate/{kind}{axis}" for kind in "tr" for axis in "xyz")


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
    frequency: Annotated[float, Gt(0)] = 200.0
    damping: Annotated[float, Ge(0), Le(10)] = 0.02

    def disturb(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Six joints between world and plate.

        Raises:
            SettingsError: They are there already.
        """
        del prefix
        if any(joint.name == _FREEDOMS[0] for joint in spec.joints):
            raise SettingsError(
                f"{self.kind}: the bedplate is on springs already; once is enough"
            )
        site = next(
            s.objname for s in spec.sensors if s.type == mujoco.mjtSensor.mjSENS_FORCE
        )
        plate = spec.site(site).parent
        place = np.asarray(spec.site(site).pos)
        kinds = [mujoco.mjtJoint.mjJNT_SLIDE] * 3 + [mujoco.mjtJoint.mjJNT_HINGE] * 3
        springs = [
            plate.add_joint(name=name, type=kind, axis=axis, pos=place)
            for name, kind, axis in zip(_FREEDOMS, kinds, [*np.eye(3)] * 2, strict=True)
        ]
        pulse = 2 * np.pi * self.frequency
        for spring, inertia in zip(springs, _inertias(spec), strict=True):
            linear = np.eye(1, np.size(spring.stiffness))[0]  # MuJoCo takes polynomials
            spring.stiffness = inertia * pulse**2 * linear
            spring.damping = 2 * self.damping * inertia * pulse * linear


@dataclass(frozen=True, eq=False)
class Tilt(Effect):
    """A bedplate that is not level: gravity is turned against what recordings say.

    Source    Our own choice: 0.2 degrees, a spirit level's.

    Attributes:
        angle: Of gravity against the z axis [rad].
        direction: Of the horizontal axis about which gravity is turned, from x [rad].
    """

    kind: ClassVar[str] = "tilt"
    angle: Annotated[float, Ge(-1.5), Le(1.5)] = 3.5e-3
    direction: float = 0.0

    def disturb(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Gravity of another direction."""
        del prefix
        axis = np.array([np.cos(self.direction), np.sin(self.direction), 0.0])
        spec.option.gravity = from_vector(self.angle * axis) @ tree.gravity


def _inertias(spec: mujoco.MjSpec) -> Array:
    """What each freedom of the plate moves, all joints at zero, (6,) [kg, kg m^2]."""
    model, data = _at_zero(spec)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return np.diagonal(matrix)[[int(model.joint(name).dofadr[0]) for name in _FREEDOMS]]


def _at_zero(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The compiled model, and its state with all joints at zero."""
    with no_mujoco_warnings():
        model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    return model, data
