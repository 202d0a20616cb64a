"""Base class of effects: plant dynamics beyond rigid bodies and dry and viscous friction.

An effect is a frozen dataclass, configured by a table `[[simulation.effect]]` of an experiment
file. It may act in three ways: as forces on the joints, computed before every step; as a change of
MuJoCo's model after its check against the model file; as a change of the robot whose parameters
are true ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Self, TypeAlias

from testbed.core.base.arrays import Array
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_table import KindTable

if TYPE_CHECKING:
    import mujoco

    from testbed.lab.simulation.gear_friction import Gears

ForceFunction: TypeAlias = Callable[[float, Array, Array, Array], Array]
"""Function for forces on the joints in addition to motors and the model's friction, (n,) [N m
or N]. Its arguments are time [s], positions, velocities and motor torques, (n,) each, joints
in the order of the tree; the forces are held over a step."""


class Effect(KindTable):
    """Effect in the simulated plant that the estimator's model does not contain.

    The methods of this base class do nothing; subclasses override those that apply.
    """

    owns_friction: ClassVar[bool] = False
    """True if the effect replaces the joints' dry and viscous friction in the plant."""

    def for_joints(self, names: tuple[str, ...]) -> Self:
        """Copy of the effect for given joints, with per-joint values in the joints' order.

        Args:
            names: Joint names.

        Raises:
            SettingsError: A joint is unknown, or values for some joints are missing.
        """
        return replace(self, **self.joint_values(names))

    def robot_with_effect(self, tree: Tree) -> Tree:
        """Robot with the true parameters that the effect adds.

        Args:
            tree: The robot of the model file.
        """
        return tree

    def force_function(self, tree: Tree, step: float) -> ForceFunction | None:
        """Function for the joint forces of the effect, called before every step.

        The result is None if the effect applies no forces.

        Args:
            tree: The robot, with its friction.
            step: Integration step [s].
        """
        del tree, step
        return None

    def true_coefficients(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """True coefficients that the effect adds to joint torque laws.

        They are keyed by law, each (n,) or (). A law is a term of the joint torque, such as Coulomb
        friction.

        Args:
            tree: The robot, with its friction.
        """
        del tree
        return {}

    def gear_friction(self, tree: Tree) -> Gears | None:
        """Load-dependent gear friction, solved together with the accelerations.

        The result is None if the effect has no such friction.

        Args:
            tree: The robot, with its friction.
        """
        del tree
        return None

    def temperature(self, time: Array) -> Array | None:
        """Temperature of the drives, (M, n) or (M, 1) [degC]; None if not modelled.

        Args:
            time: Times, (M,) [s].
        """
        del time
        return None

    def add_to_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Add bodies and joints to MuJoCo's model before it is checked against the robot.

        Args:
            spec: MuJoCo's editable model of the robot on its plate.
            tree: The robot, effects included.
            prefix: Prefix of the joints' names in `spec`.
        """

    def change_model(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Change MuJoCo's model after its check, beyond what the robot's tree describes.

        Args:
            spec: MuJoCo's editable model of the robot on its plate.
            tree: The robot, effects included.
            prefix: Prefix of the joints' names in `spec`.
        """
