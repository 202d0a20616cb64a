"""A motion: time and the joints' positions, velocities and accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly


@dataclass(frozen=True, eq=False)
class Motion:
    """M samples of the motion of n joints, columns in the order of `tree.names`.

    Attributes:
        t: Time, (M,) [s].
        q: Joint positions, (M, n) [rad or m].
        qd: Velocities, (M, n) [rad/s or m/s].
        qdd: Accelerations, (M, n) [rad/s^2 or m/s^2].
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", readonly(self.t, (None,), "t"))
        shape = (len(self.t), np.shape(self.q)[-1] if np.ndim(self.q) else 0)
        for name in ("q", "qd", "qdd"):
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))

    @property
    def samples(self) -> int:
        """Number M of samples."""
        return len(self.t)

    def __getitem__(self, part: slice) -> Motion:
        """The samples of a slice."""
        return Motion(self.t[part], self.q[part], self.qd[part], self.qdd[part])
