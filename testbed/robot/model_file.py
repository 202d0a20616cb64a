"""A model file, and how it is to be read: the same way for the tree, the plant and the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from testbed.robot.load import load_tree
from testbed.robot.repair import Bodies
from testbed.robot.tree import Tree


@dataclass(frozen=True)
class ModelFile:
    """An MJCF or URDF file, and how to read it.

    Attributes:
        path: The file.
        weld_root: Weld a floating root to the bedplate.
        repair: Bodies in place of those that cannot be, by the link that carries them; {} refuses
            such a file, None takes the nearest bodies.
        lock: Joints that are held, and where [rad or m]; None: where the joint rests.
    """

    path: Path
    weld_root: bool = False
    repair: Bodies | None = None
    lock: Mapping[str, float | None] = field(default_factory=dict)

    def tree(self) -> Tree:
        """The robot.

        Raises:
            ModelError: The file cannot be read or holds what is not supported.
        """
        return load_tree(
            self.path,
            weld_root=self.weld_root,
            repair=self.repair,
            lock=self.lock,
        )
