"""How commands about recordings read the robot and treat the signals: options that they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from testbed.experiment.experiment import RecordingTables
    from testbed.robot.model_file import ModelFile
    from testbed.robot.tree import Tree


@dataclass(frozen=True)
class Reading:
    """What was said of a recording's robot and treatment.

    Attributes:
        settings: Words of --set.
        zeros: Whether --zeros was given.
        weld_root: Whether --weld-root was given.
        accept_inertia: Whether --accept-inertia was given.
        lock: Words of --lock.
        lock_mimic: Whether --lock-mimic was given.
    """

    settings: Sequence[str] | None = None
    zeros: bool = False
    weld_root: bool = False
    accept_inertia: bool = False
    lock: Sequence[str] | None = None
    lock_mimic: bool = False

    def tables(self) -> RecordingTables:
        """Settings of robot and identification.

        Raises:
            ExperimentError: --set says what is not understood.
        """
        from testbed.experiment.experiment import RecordingTables

        zeros = ["identification.zeros=true"] if self.zeros else []
        return RecordingTables.of([*(self.settings or ()), *zeros])

    def model_file(self, path: Path) -> ModelFile:
        """A model file, and how to read it."""
        from testbed.robot.load import mimic_joints
        from testbed.robot.locks import parse_lock
        from testbed.robot.model_file import ModelFile

        said = self.tables().robot
        mimic = mimic_joints(path) if self.lock_mimic or said.lock_mimic else ()
        held = dict.fromkeys(mimic) | said.lock | parse_lock(self.lock or ())
        return ModelFile(path, self.weld_root, self.accept_inertia, held)

    def tree(self, path: Path) -> Tree:
        """The robot of a model file, with what --set says of its joints."""
        return self.model_file(path).tree().with_joints(self.tables().robot.settings)
