"""An effect: something in the plant that the plain laws of rigid bodies and dry friction leave out.

An effect is one frozen dataclass that an experiment file asks for, `[[simulation.effect]]`. It
may act in three ways: on the joints, before every step; on MuJoCo's model, once it has proved to be
the robot of the model file; and on the robot itself, where what it adds is part of the truth.
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

StepForces: TypeAlias = Callable[[float, Array, Array, Array], Array]
"""Forces on the joints besides motors and the model's friction, (n,) [N m or N], of time [s],
positions, velocities and motor torques, (n,) each, joints in the order of the tree; held over a
step."""


class Effect(KindTable):
    """One effect in the plant."""

    owns_friction: ClassVar[bool] = False
    """Whether it takes the place of the joints' own friction, which the plant then has not."""

    def on(self, names: tuple[str, ...]) -> Self:
        """The same effect on a robot: numbers a joint, in their order.

        Args:
            names: Joint names.

        Raises:
            SettingsError: It names a joint that is not there, or not of all.
        """
        return replace(self, **self.of_joints(names))

    def robot(self, tree: Tree) -> Tree:
        """The robot with what the effect adds to it: what is true of it then.

        Args:
            tree: The robot as its model file has it.
        """
        return tree

    def forces(self, tree: Tree, step: float) -> StepForces | None:
        """What acts on the joints, asked before every step; None for nothing.

        Args:
            tree: The robot, with its friction.
            step: Of the integration [s].
        """
        del tree, step
        return None

    def terms(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """True coefficients that it adds to laws of the joints' torques, (n,) or ().

        Args:
            tree: The robot, with its friction.
        """
        del tree
        return {}

    def gears(self, tree: Tree) -> Gears | None:
        """Friction of gears that is solved with the motion at every step; None for none.

        Args:
            tree: The robot, with its friction.
        """
        del tree
        return None

    def temperature(self, time: Array) -> Array | None:
        """Of the drives, (M, n) or (M, 1) [degC]; None where the effect leaves it open.

        Args:
            time: (M,) [s].
        """
        del time
        return None

    def equip(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Add what is part of the robot to MuJoCo's model, before that is checked.

        Args:
            spec: The robot on its plate.
            tree: The robot, effects included.
            prefix: Of the joints' names in `spec`.
        """

    def disturb(self, spec: mujoco.MjSpec, tree: Tree, prefix: str) -> None:
        """Change MuJoCo's model in a way that the tree does not have, after it was checked.

        Args:
            spec: The robot on its plate.
            tree: The robot, effects included.
            prefix: Of the joints' names in `spec`.
        """
