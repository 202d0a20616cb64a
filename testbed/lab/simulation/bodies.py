"""Effects of bodies: payload, geared rotors, compliant bedplate, tilt of gravity."""

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
from testbed.core.parameters.rules import triad_about
from testbed.core.robot.formats.mjcf_compile import suppress_mujoco_warnings
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.rotations import matrix_to_quaternion, rotvec_to_matrix
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import Effect
from testbed.sensors.kind_table import PerAxis, PerJoint, joint_array

MASSLESS = 1e-9
"""Mass of a body that has only inertia [kg]: MuJoCo requires a positive mass."""


@dataclass(frozen=True, eq=False)
class Payload(Effect):
    """Rigid body fixed to a link, such as a tool or a load.

    Its parameters are part of the robot's true parameters.

    Source    Our own choice: 1 kg, a sphere of 7 cm.

    Attributes:
        joint: Joint that moves the link; "" for the last joint.
        mass: Mass of the payload [kg].
        centre: Centre of mass in the frame of the joint's body, one number for x, y and z or three
            [m].
        inertia: Moments of inertia about the centre of mass, one number or three [kg m^2].
    """

    kind: ClassVar[str] = "payload"
    joint: str = ""
    mass: Annotated[float, Gt(0)] = 1.0
    centre: PerAxis = 0.05
    inertia: Annotated[PerAxis, Gt(0)] = 2e-3

    @property
    def body(self) -> Inertia:
        """Mass, centre and inertia of the payload in the frame of the joint's body."""
        centre, moments = (np.broadcast_to(v, 3) for v in (self.centre, self.inertia))
        return Inertia.about_centre(self.mass, centre, np.diag(moments))

    def robot_with_effect(self, tree: Tree) -> Tree:
        """Robot with the payload added to the carrying link.

        Raises:
            SettingsError: The robot has no such joint.
        """
        if self.joint and self.joint not in tree.names:
            raise SettingsError(
                f"payload: {UnknownName('joint', self.joint, tree.names)}"
            )
        return tree.with_inertia(self._link_index(tree), self.body)

    def add_to_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Add the payload to MuJoCo's model as a body welded to the carrying link."""
        link = self._link_index(tree)
        body = spec.joint(prefix + tree.names[link]).parent
        centre, moments = (np.broadcast_to(v, 3) for v in (self.centre, self.inertia))
        X_LC = Transform(p_AB_A=centre)
        _weld(spec, body, "testbed/payload", tree, link, X_LC, self.mass, moments)

    def _link_index(self, tree: Tree) -> int:
        """Index of the joint that moves the carrying link."""
        return tree.index(self.joint) if self.joint else tree.n - 1


@dataclass(frozen=True, eq=False)
class GearedRotor(Effect):
    """Motor rotor on the previous link that turns `ratio` times as fast as its joint.

    Its angular momentum adds `ratio * inertia * d(qd e)/dt` to the base wrench, where e is the
    joint axis. This equals the effect of an inertia `ratio * inertia` about e that is added to the
    joint's body and removed from the carrying link. The rotor inertia in the model file is kept in
    addition. The joint must be revolute.

    Source    [AKB86]: a PUMA's waist, 1.14 kg m^2 at the joint by a ratio of 62.6.

    Attributes:
        inertia: Moment of inertia of the rotor about its axis [kg m^2].
        ratio: Gear ratio: turns of the rotor per turn of the joint.
    """

    kind: ClassVar[str] = "geared_rotor"
    inertia: Annotated[PerJoint, Ge(0)] = 2e-4
    ratio: PerJoint = 60.0

    def robot_with_effect(self, tree: Tree) -> Tree:
        """Robot with the rotor inertias added to the carrying links and to the joints.

        The carrying link receives the inertia of the rotor at rest; the inertia about the
        transverse axes is half of that about the rotor's axis. The joint's rotor inertia increases
        by ratio^2 times the inertia.

        Raises:
            SettingsError: A joint that has such a rotor is prismatic.
        """
        for joint, inertia, ratio in self._rotors(tree):
            if not tree.joints[joint].revolute:
                raise SettingsError(
                    f"geared_rotor: joint '{tree.names[joint]}' slides; give inertia by joint name"
                )
            tree_joint = tree.joints[joint]
            axis = tree_joint.carried_axis
            rest_inertia = inertia / 2 * (np.eye(3) + np.outer(axis, axis))
            tree = tree.with_inertia(
                tree_joint.parent, Inertia(0.0, np.zeros(3), rest_inertia)
            )
            reflected = tree_joint.rotor_inertia + ratio**2 * inertia
            tree = tree.with_joints({tree_joint.name: {"rotor_inertia": reflected}})
        return tree

    def add_to_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Add the rotors to MuJoCo's model as massless bodies welded to the carrying links.

        The armatures of the joints are set to the rotor inertias of `tree`, including the rotors'
        spin.
        """
        for joint, inertia, _ in self._rotors(tree):
            tree_joint = tree.joints[joint]
            hinge, moments = (
                spec.joint(prefix + tree_joint.name),
                inertia * np.array([0.5, 0.5, 1.0]),
            )
            frame = tree, joint, Transform(triad_about(tree_joint.axis).R_BT)
            _weld(
                spec,
                hinge.parent.parent,
                _rotor_name(tree_joint.name),
                *frame,
                MASSLESS,
                moments,
            )
            hinge.armature = tree_joint.rotor_inertia

    def change_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Connect the rotors by hinges, coupled to the joints with the gear ratio.

        The inertia of the rotors' spin is subtracted again from the armatures of the joints.
        """
        step = spec.option.timestep
        for joint, inertia, ratio in self._rotors(tree):
            name = prefix + tree.names[joint]
            rotor = _rotor_name(tree.names[joint])
            spec.body(rotor).add_joint(
                name=rotor, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1]
            )
            spec.joint(name).armature -= ratio**2 * inertia
            gear = spec.add_equality(name=rotor, type=mujoco.mjtEq.mjEQ_JOINT)
            gear.objtype = mujoco.mjtObj.mjOBJ_JOINT
            gear.name1, gear.name2 = rotor, name
            gear.data[:5] = [0.0, ratio, 0.0, 0.0, 0.0]
            gear.solref, gear.solimp = [2 * step, 1], [0.9999, 0.9999, 0.001, 0.5, 2]

    def _rotors(self, tree: Tree) -> Iterator[tuple[int, float, float]]:
        """Yield joint index, inertia [kg m^2] and gear ratio of each rotor.

        Rotors with zero inertia or zero ratio are skipped.
        """
        sizes, ratios = (
            np.broadcast_to(joint_array(value), tree.n)
            for value in (self.inertia, self.ratio)
        )
        for joint, (inertia, ratio) in enumerate(zip(sizes, ratios, strict=True)):
            if inertia and ratio:
                yield joint, float(inertia), float(ratio)


def _rotor_name(joint: str) -> str:
    """Name of the rotor's body in MuJoCo's model."""
    return f"testbed/rotor/{joint}"


def _weld(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    name: str,
    tree: Tree,
    link: int,
    X_LC: Transform,
    mass: float,
    moments: Array,
) -> None:
    """Add a body to MuJoCo's model, fixed to an existing body.

    Args:
        spec: MuJoCo's editable model of the robot.
        parent: Existing body.
        name: Name of the new body.
        tree: The robot.
        link: Index of the joint whose body frame is L; poses are those with all joints at zero.
        X_LC: Pose in L of the frame C, which has its origin at the centre of mass and its axes
            along the principal axes.
        mass: Mass of the new body [kg].
        moments: Principal moments of inertia of the new body, (3,) [kg m^2].
    """
    parent_state = _zero_state(spec)[1].body(parent.name)
    X_WT = Transform(parent_state.xmat.reshape(3, 3), parent_state.xpos)
    X_TC = X_WT.inverse @ tree.zero_poses[link] @ X_LC
    parent.add_body(
        name=name,
        pos=X_TC.p_AB_A,
        quat=matrix_to_quaternion(X_TC.R_AB),
        mass=mass,
        ipos=np.zeros(3),  # MuJoCo's default would be `pos`
        iquat=[1.0, 0.0, 0.0, 0.0],
        inertia=moments,
        explicitinertial=True,
    )


_PLATE_JOINTS = tuple(f"testbed/plate/{kind}{axis}" for kind in "tr" for axis in "xyz")


@dataclass(frozen=True, eq=False)
class CompliantPlate(Effect):
    """Bedplate on three translational and three rotational springs about its origin.

    The stiffness of each spring follows from its natural frequency, for the robot with all joints
    at zero.

    Source    Our own choice: plates with strain gauges under robots of 60 kg, 60 to 200 Hz.

    Attributes:
        frequency: Natural frequency of each spring with the robot on the plate [Hz].
        damping: Damping ratio of each spring, relative to critical damping.
    """

    kind: ClassVar[str] = "compliant_plate"
    frequency: Annotated[float, Gt(0)] = 200.0
    damping: Annotated[float, Ge(0), Le(10)] = 0.02

    def change_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Add six joints with springs and dampers between world and bedplate.

        Raises:
            SettingsError: The model already has these joints.
        """
        del prefix
        if any(joint.name == _PLATE_JOINTS[0] for joint in spec.joints):
            raise SettingsError(
                f"{self.kind}: the bedplate is on springs already; once is enough"
            )
        site = next(
            s.objname for s in spec.sensors if s.type == mujoco.mjtSensor.mjSENS_FORCE
        )
        plate = spec.site(site).parent
        origin = np.asarray(spec.site(site).pos)
        kinds = [mujoco.mjtJoint.mjJNT_SLIDE] * 3 + [mujoco.mjtJoint.mjJNT_HINGE] * 3
        springs = [
            plate.add_joint(name=name, type=kind, axis=axis, pos=origin)
            for name, kind, axis in zip(
                _PLATE_JOINTS, kinds, [*np.eye(3)] * 2, strict=True
            )
        ]
        angular_frequency = 2 * np.pi * self.frequency
        for spring, inertia in zip(springs, _plate_inertias(spec), strict=True):
            linear = np.eye(1, np.size(spring.stiffness))[0]  # MuJoCo takes polynomials
            spring.stiffness = inertia * angular_frequency**2 * linear
            spring.damping = 2 * self.damping * inertia * angular_frequency * linear


@dataclass(frozen=True, eq=False)
class Tilt(Effect):
    """Tilt of the bedplate: gravity differs in direction from the recorded gravity.

    Source    Our own choice: 0.2 degrees, a spirit level's.

    Attributes:
        angle: Angle between gravity and the z axis [rad].
        direction: Direction of the horizontal rotation axis, measured from the x axis [rad].
    """

    kind: ClassVar[str] = "tilt"
    angle: Annotated[float, Ge(-1.5), Le(1.5)] = 3.5e-3
    direction: float = 0.0

    def change_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Rotate the gravity vector of MuJoCo's model about the horizontal axis."""
        del prefix
        axis = np.array([np.cos(self.direction), np.sin(self.direction), 0.0])
        spec.option.gravity = rotvec_to_matrix(self.angle * axis) @ tree.gravity


def _plate_inertias(spec: mujoco.MjSpec) -> Array:
    """Effective inertia of each bedplate joint with all joints at zero, (6,) [kg, kg m^2].

    This is the diagonal of MuJoCo's mass matrix.
    """
    model, data = _zero_state(spec)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return np.diagonal(matrix)[
        [int(model.joint(name).dofadr[0]) for name in _PLATE_JOINTS]
    ]


def _zero_state(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compiled model, and the state with all joints at zero."""
    with suppress_mujoco_warnings():
        model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    return model, data
