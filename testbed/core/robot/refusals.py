"""Errors for model files that cannot be read as a tree; the messages include remedies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from testbed.core.base.errors import MAX_LIST_WIDTH, ModelError, shortened_list


class InertiaError(ModelError):
    """Error for physically inconsistent link inertias; `flaws` holds one line per link."""

    def __init__(self, source: str, flaws: Sequence[str]) -> None:
        self.flaws = tuple(flaws)
        super().__init__(
            f"{source}: {shortened_list(self.flaws, MAX_LIST_WIDTH, '; ')}. Correct the file, or "
            "take the nearest bodies that can be: `testbed new` writes them into an experiment "
            "file ([robot.repair])"
        )


class FreeRootError(ModelError):
    """Error for a floating root; `joint` holds the name of the free joint."""

    def __init__(self, source: str, joint: str) -> None:
        self.joint = joint
        super().__init__(
            f"{source}: joint '{joint}' leaves the root free to float, and a bedplate carries a "
            "fixed root; pass --weld-root (weld_root=True; in an experiment weld_root = true) to "
            "weld it to the bedplate"
        )


class MimicError(ModelError):
    """Error for mimic joints that are not locked; `masters` maps mimic joints to master joints."""

    def __init__(
        self, source: str, masters: Mapping[str, str], hold: Sequence[str]
    ) -> None:
        self.masters = dict(masters)
        names = list(dict.fromkeys(hold))
        first, master = next(iter(masters.items()))
        number = f" ({len(masters)} such joints)" if len(masters) > 1 else ""
        options = " ".join(f"--lock {name}" for name in names[:2]) + " ..." * (
            len(names) > 2
        )
        super().__init__(
            f"{source}: joint '{first}' follows '{master}'{number}, which a tree cannot express. "
            f"{options} holds followed and followers, --lock-mimic followers only (in an "
            "experiment lock and lock_mimic under [robot]; in Python "
            "lock=dict.fromkeys(mimic_joints(path)))"
        )


class LoopError(ModelError):
    """Error for a constraint that closes a loop; `joints` holds rest positions along the loop."""

    def __init__(
        self, source: str, constraint: str, joints: Mapping[str, float]
    ) -> None:
        self.joints = dict(joints)
        options = " ".join(f"--lock {name}" for name in self.joints)
        super().__init__(
            f"{source}: equality constraint {constraint} closes a loop, which is not supported. "
            f"{options} holds all joints along it (in an experiment lock under [robot])"
        )
