"""Errors of model files that a tree cannot express as they are: what is wrong, and what helps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from testbed.core.base.errors import WIDTH, ModelError, few


class InertiaError(ModelError):
    """Links whose inertial parameters no rigid body can have; `flaws` holds one line each."""

    def __init__(self, source: str, flaws: Sequence[str]) -> None:
        self.flaws = tuple(flaws)
        super().__init__(
            f"{source}: {few(self.flaws, WIDTH, '; ')}. Correct the file, or take the nearest "
            "bodies that can be: `testbed new` writes them into an experiment file ([robot.repair])"
        )


class FreeRootError(ModelError):
    """The robot's root floats freely; `joint` names the free joint."""

    def __init__(self, source: str, joint: str) -> None:
        self.joint = joint
        super().__init__(
            f"{source}: joint '{joint}' leaves the root free to float, and a bedplate carries a "
            "fixed root; pass --weld-root (weld_root=True; in an experiment weld_root = true) to "
            "weld it to the bedplate"
        )


class MimicError(ModelError):
    """Joints that follow others, which a tree cannot express; `masters` by follower."""

    def __init__(
        self, source: str, masters: Mapping[str, str], hold: Sequence[str]
    ) -> None:
        self.masters = dict(masters)
        names = list(dict.fromkeys(hold))
        first, master = next(iter(masters.items()))
        more = f" ({len(masters)} such joints)" if len(masters) > 1 else ""
        options = " ".join(f"--lock {name}" for name in names[:2]) + " ..." * (
            len(names) > 2
        )
        super().__init__(
            f"{source}: joint '{first}' follows '{master}'{more}, which a tree cannot express. "
            f"{options} holds followed and followers, --lock-mimic followers only (in an "
            "experiment lock and lock_mimic under [robot]; in Python "
            "lock=dict.fromkeys(mimic_joints(path)))"
        )


class LoopError(ModelError):
    """A constraint that closes a loop, none of a tree; where `joints` along it rest."""

    def __init__(
        self, source: str, constraint: str, joints: Mapping[str, float]
    ) -> None:
        self.joints = dict(joints)
        options = " ".join(f"--lock {name}" for name in self.joints)
        super().__init__(
            f"{source}: equality constraint {constraint} closes a loop, which is not supported. "
            f"{options} holds all joints along it (in an experiment lock under [robot])"
        )
