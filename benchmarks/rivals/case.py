"""A case of bedplate-bench, read with NumPy alone, and answers written: what every rival shares."""

from __future__ import annotations

import argparse
import json
import logging
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOW = 0.02
"""Below this speed a joint is at a reversal [rad/s or m/s]."""


@dataclass(frozen=True, eq=False)
class Case:
    """A recording, and the states at which to predict.

    Attributes:
        name: Of the case.
        urdf: The model file.
        joints: Names.
        t: Times, (M,) [s].
        q: Positions, (M, n) [rad or m].
        torque: Of the drives, (M, n) [N m or N].
        wrench: Of the plate on the robot, (M, 6) [N, N m].
        unseen: Positions, velocities and accelerations of another motion, (m, n) each.
    """

    name: str
    urdf: Path
    joints: tuple[str, ...]
    t: Array
    q: Array
    torque: Array
    wrench: Array
    unseen: tuple[Array, Array, Array]

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return float(1 / np.diff(self.t).mean())

    def away(self, qd: Array, seconds: float) -> NDArray[np.bool_]:
        """Whether joints are not at a reversal, nor shortly before or after one, (M, n).

        Args:
            qd: Velocities, (M, n).
            seconds: How long: filters spread dry friction's jump.
        """
        reach = round(seconds * self.rate)
        near = (np.abs(qd) < SLOW).astype(float)
        spread = [np.convolve(each, np.ones(2 * reach + 1), "same") for each in near.T]
        return np.asarray(np.array(spread).T < 0.5)


Answer = dict[str, Any]
Solver = Callable[[Case, str], Answer]
"""From a case and "torque" or "wrench" to "prediction", (m, k), and perhaps "sigma", "said", "cpu"
of identification alone [s], and "model", text of a model file with what was found."""


def read(folder: Path) -> Case:
    """One case.

    Args:
        folder: Of the case.
    """
    with (folder / "unseen.csv").open() as file:
        names = file.readline().split(",")
        unseen = np.loadtxt(file, delimiter=",")
    n = (len(names) - 1) // 3
    signals = np.loadtxt(folder / "recording.csv.gz", delimiter=",", skiprows=1)
    t, q, torque, wrench = np.split(signals, [1, 1 + n, 1 + 2 * n], axis=1)
    joints = tuple(name.removeprefix("q_") for name in names[1 : 1 + n])
    q_new, qd_new, qdd_new = np.split(unseen[:, 1:], 3, axis=1)
    return Case(
        folder.name,
        folder / "robot.urdf",
        joints,
        t[:, 0],
        q,
        torque,
        wrench,
        (q_new, qd_new, qdd_new),
    )


def answer(settings: Mapping[str, Solver], version: str) -> None:
    """Answer the cases of a folder, as the command line says.

    Args:
        settings: Ways of doing it, by name.
        version: Of the rival.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--setting", choices=list(settings), required=True)
    parser.add_argument("--draws", type=int, default=10**6)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    found: dict[str, Any] = {}
    for place in sorted((given.folder / "recordings").iterdir()):
        if re.search(given.only, place.name) and int(place.name[-2:]) < given.draws:
            found[place.name] = dict(_answered(read(place), settings[given.setting]))
    given.out.write_text(
        json.dumps({"version": version, "seconds": time.process_time(), "answers": found})
    )


def _answered(case: Case, solve: Solver) -> Iterator[tuple[str, Any]]:
    cpu: dict[str, float] = {}
    said: list[str] = []
    heard = logging.Handler(logging.WARNING)
    heard.emit = lambda record: said.append(str(record.msg))  # type: ignore[method-assign]
    logging.getLogger().addHandler(heard)
    logging.captureWarnings(True)
    for signal in ("torque", "wrench"):
        start = time.process_time()
        try:
            found = solve(case, signal)
        except NotImplementedError:  # the rival has no way to use this signal
            continue
        except Exception as error:  # as a user would see it
            said.append(type(error).__name__)
            continue
        cpu[signal] = found.get("cpu", time.process_time() - start)
        said += found.get("said", ())
        names = {"prediction": signal} | {k: f"{signal}_{k}" for k in ("sigma", "expected")}
        for key, name in names.items():
            if key in found:
                yield name, [[float(f"{x:.7g}") for x in row] for row in found[key]]
        if "model" in found:
            yield f"{signal}_model", found["model"]
    logging.getLogger().removeHandler(heard)
    yield from (("said", said), ("cpu", cpu))
