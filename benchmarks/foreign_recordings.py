"""Files as other programs write them, of recordings that the project has not made.

What a mapping has to say is planted in the files: the plate's frame, units, sense and zero, how
late it is, torques in another order or sense, degrees. Turns and units are SciPy's and this
module's own, so that nothing of the project is believed twice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from benchmarks.inverse_recordings import RATE, Truth, truth
from testbed.core.base.arrays import Array

FORCE = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}
MOMENT = {"N m": 1.0, "N mm": 1e-3, "N cm": 1e-2, "kN m": 1e3, "lbf in": 4.4482216152605 * 0.0254,
          "lbf ft": 4.4482216152605 * 0.3048, "kgf m": 9.80665, "kgf cm": 0.0980665}  # fmt: skip
"""One of each in N, and in N m."""

PAIRS = (
    ("lbf", "lbf in"), ("lbf", "lbf ft"), ("kgf", "kgf m"), ("kgf", "kgf cm"), ("N", "N mm"),
    ("N", "N cm"), ("kN", "kN m"),
)  # fmt: skip
"""Units that plates have, besides N and N m."""

TURNS = ("quarter", "fifteen", "any")
"""Of a plate's frame: multiples of 90 degrees, of 15 about each axis, or anyhow."""

LATE = 40e-3
"""Most that the plate's clock is off [s]."""

Stamps: TypeAlias = Array | NDArray[np.int64]

LETTERS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True, eq=False)
class Planted:
    """What a mapping of a file must say.

    Attributes:
        what: In words.
        turn: From the plate's frame to the robot's, (3, 3).
        place: Of the plate's origin in the robot's frame, (3,) [m].
        units: Of forces and moments.
        sense: 1 where the plate shows what it does to the robot, else -1.
        zero: What the plate shows besides, in the robot's frame, (6,) [N, N m].
        late: The plate shows what was so long ago [s].
        degrees: Whether joints that turn are in degrees.
        order: Column of each joint's torque, (n,).
        sign: Of each joint's torque, (n,).
    """

    what: str
    turn: Array
    place: Array
    units: tuple[str, str] = ("N", "N m")
    sense: int = 1
    zero: Array = field(default_factory=lambda: np.zeros(6))
    late: float = 0.0
    degrees: bool = False
    order: tuple[int, ...] = ()
    sign: tuple[int, ...] = ()

    @property
    def map(self) -> Array:
        """From the plate's six numbers to the wrench in the robot's frame, (6, 6)."""
        size = self.sense * np.repeat([FORCE[self.units[0]], MOMENT[self.units[1]]], 3)
        return np.asarray(moved(self.turn, self.place) * size)


def moved(turn: Array, place: Array) -> Array:
    """A wrench of a frame that is turned and lies elsewhere, in the robot's own, (6, 6)."""
    found: Array = np.asarray(np.kron(np.eye(2), turn), dtype=np.float64)
    found[3:, :3] = np.cross(place, turn, axisb=0, axisc=0)
    return found


@dataclass(frozen=True, eq=False)
class Files:
    """What was written.

    Attributes:
        paths: Of the files.
        columns: By file's name and column: signal and number, (signal, k).
        stamps: By file's name and column of times: these, (M,), of ROS in nanoseconds.
        raw: Signals as the files hold them, (M, k) each.
    """

    paths: tuple[Path, ...]
    columns: Mapping[tuple[str, str], tuple[str, int]]
    stamps: Mapping[tuple[str, str], Stamps]
    raw: Mapping[str, Array]


def planted(robot: str, kind: str, layout: str, seed: int) -> tuple[Truth, Planted]:
    """A recording and what a mapping of its files must say.

    Args:
        robot: One of `ROBOTS`.
        kind: One of `TURNS`.
        layout: One of `LAYOUTS`.
        seed: Of all of it.
    """
    rng = np.random.default_rng([seed, 1])
    late = rng.uniform(-LATE, LATE) if layout == "two_csv" or rng.random() < 0.7 else 0.0
    made = truth(robot, seed, late=late)
    n, weight = made.tree.n, made.weight
    angles = {"quarter": 90 * rng.integers(4, size=3), "fifteen": 15 * rng.integers(24, size=3)}
    turn = Rotation.from_euler("xyz", angles[kind], degrees=True) if kind in angles else (
        Rotation.random(random_state=int(rng.integers(1 << 31))))  # fmt: skip
    order, sign = list(range(n)), [1] * n
    said = [f"{late * 1e3:.1f} ms late"] if late else []
    found = Planted(
        "", turn.as_matrix(), rng.uniform(-0.1, 0.1, 3) * (rng.random() < 0.8),
        zero=weight * rng.normal(size=6) * np.repeat([0.1, 0.05], 3), late=late,
        degrees=layout == "ros" or bool(rng.random() < 0.4),
    )  # fmt: skip
    if rng.random() < 0.6:
        found = replace(found, units=PAIRS[rng.integers(len(PAIRS))])
        said.append(", ".join(found.units))
    if rng.random() < 0.4:
        found = replace(found, sense=-1)
        said.append("on the plate")
    if rng.random() < 0.3:
        one, other = rng.choice(n, 2, replace=False)
        order[one], order[other] = order[other], order[one]
        said.append(f"torques {one + 1}, {other + 1} exchanged")
    if rng.random() < 0.3:
        k = int(rng.integers(n))
        sign[k] = -1
        said.append(f"torque {k + 1} negative")
    said += ["degrees"] * found.degrees + ["shifted"] * bool(found.place.any())
    return made, replace(found, what="; ".join(said), order=tuple(order), sign=tuple(sign))


def raw_signals(made: Truth, told: Planted) -> dict[str, Array]:
    """Signals as a file holds them, (M, k) each."""
    turning = np.array([joint.revolute for joint in made.tree.joints])
    degree = np.where(turning & told.degrees, 180 / np.pi, 1.0)
    raw = {"position": made.position * degree, "torque": np.empty_like(made.torque)}
    raw["torque"][:, list(told.order)] = made.torque * told.sign
    if made.wrench is not None:
        raw["wrench"] = (made.wrench + told.zero) @ np.linalg.inv(told.map).T
    return raw


EPOCH = 1_700_000_000_000_000_000
"""Of the clocks of ROS [ns]."""


def ros(folder: Path, made: Truth, raw: dict[str, Array], _seed: int) -> Files:
    """Names of ROS, stamps in nanoseconds since 1970."""
    said = {f"/joint_states/{j}/position": ("position", k) for k, j in enumerate(made.tree.names)}
    said |= {f"/joint_states/{j}/effort": ("torque", k) for k, j in enumerate(made.tree.names)}
    said |= {f"/plate/wrench/{part}/{axis}": ("wrench", 3 * (part == "torque") + k)
             for part in ("force", "torque") for k, axis in enumerate("xyz")}  # fmt: skip
    stamps = EPOCH + np.arange(len(made.position), dtype=np.int64) * round(1e9 / RATE)
    return _one(folder / "bag.csv", said, raw, stamps, stamp="/joint_states/header/stamp")


def two_csv(folder: Path, made: Truth, raw: dict[str, Array], seed: int) -> Files:
    """Robot and plate in files of their own, whose clocks start anywhere."""
    t = np.arange(len(made.position)) / RATE
    n = made.tree.n
    robot: dict[str, tuple[str, int]] = {f"q{k + 1}": ("position", k) for k in range(n)}
    robot |= {f"tau{k + 1}": ("torque", k) for k in range(n)}
    starts = np.random.default_rng([seed, 2]).uniform(0, 500, 2).round(3)
    one = _one(folder / "robot.csv", robot, raw, t + starts[0])
    plate: dict[str, tuple[str, int]] = {name: ("wrench", k) for k, name in enumerate(LETTERS)}
    other = _one(folder / "plate.csv", plate, raw, t + starts[1])
    stamps = {**one.stamps, **other.stamps}
    return Files(one.paths + other.paths, {**one.columns, **other.columns}, stamps, raw)


def mat(folder: Path, made: Truth, raw: dict[str, Array], seed: int) -> Files:
    """MATLAB: an array a joint, or a matrix a signal."""
    t, path = np.arange(len(made.position)) / RATE, folder / "log.mat"
    names = {"position": "q", "torque": "tau", "wrench": "ft"}
    said: dict[str, tuple[str, int]]
    if seed % 2:
        said = {f"{names[s]}{k + 1}": (s, k) for s in ("position", "torque")
                for k in range(made.tree.n)}  # fmt: skip
        said |= {name: ("wrench", k) for k, name in enumerate(LETTERS)}
        savemat(path, {"t": t, **{name: raw[s][:, k] for name, (s, k) in said.items()}})
    else:
        said = {f"{names[s]}[{k}]": (s, k) for s in raw for k in range(raw[s].shape[1])}
        savemat(path, {"t": t, **{names[s]: values for s, values in raw.items()}})
    return _files(path, said, {"t": t}, raw)


def lerobot(folder: Path, made: Truth, raw: dict[str, Array], _seed: int) -> Files:
    """LeRobot's Parquet: lists of single precision, an action beside the state."""
    names = {"position": "observation.state", "torque": "observation.effort",
             "wrench": "observation.wrench"}  # fmt: skip
    count = len(made.position)
    stamps = (np.arange(count) / RATE).astype(np.float32)
    table = {
        name: pa.FixedSizeListArray.from_arrays(
            pa.array(raw[s].astype(np.float32).ravel()), raw[s].shape[1]
        )
        for s, name in names.items()
    }
    table["action"] = pa.FixedSizeListArray.from_arrays(
        pa.array(np.roll(raw["position"], -5, axis=0).astype(np.float32).ravel()), made.tree.n
    )
    table |= {"timestamp": pa.array(stamps), "frame_index": pa.array(np.arange(count)),
              "episode_index": pa.array(np.zeros(count, int)), "index": pa.array(np.arange(count)),
              "task_index": pa.array(np.zeros(count, int))}  # fmt: skip
    pq.write_table(pa.table(table), folder / "episode_000000.parquet")
    said = {f"{names[s]}[{k}]": (s, k) for s in names for k in range(raw[s].shape[1])}
    raw = {s: values.astype(np.float32).astype(float) for s, values in raw.items()}
    path = folder / "episode_000000.parquet"
    return _files(path, said, {"timestamp": stamps.astype(float)}, raw)


def _one(
    path: Path, said: Mapping[str, tuple[str, int]], raw: Mapping[str, Array], stamps: Stamps,
    stamp: str = "t",
) -> Files:  # fmt: skip
    """A text file, the times first; nanoseconds since 1970 have digits of their own."""
    counted = stamps.dtype.kind == "i"
    columns = [stamps - EPOCH * counted, *(raw[s][:, k] for s, k in said.values())]
    digits = [f"{str(EPOCH)[:8]}%011d" if counted else "%.6f", *["%.9g"] * len(said)]
    head = ",".join([stamp, *said])
    np.savetxt(path, np.column_stack(columns), digits, ",", header=head, comments="")
    return _files(path, said, {stamp: stamps}, raw)


def _files(
    path: Path, said: Mapping[str, tuple[str, int]], stamps: Mapping[str, Stamps],
    raw: Mapping[str, Array],
) -> Files:  # fmt: skip
    columns = {(path.name, name): each for name, each in said.items()}
    times = {(path.name, name): each for name, each in stamps.items()}
    return Files((path,), columns, times, raw)


LAYOUTS: dict[str, Callable[[Path, Truth, dict[str, Array], int], Files]] = {
    "ros": ros, "two_csv": two_csv, "mat": mat, "lerobot": lerobot,
}  # fmt: skip
"""Each writes its files into a folder."""
