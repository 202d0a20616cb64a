"""Recordings with one thing wrong: of robots that are not their files', by Pinocchio, and real.

Bodies differ from the model file's; half of the robots carry a tool that the file lacks. Friction,
an encoder of 17 bit, torques that wander, ripple and feel their neighbours are added here. Mistakes
of a mapping are planted in the mapping, the rest in the data.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import testbed as tb
from benchmarks import real
from benchmarks.inverse_recordings import ENCODER, inverse, on_a_free_base, real_robot, states
from benchmarks.mistakes import mapping_of
from testbed.core.base.arrays import Array
from testbed.core.robot.model_file import ModelFile
from testbed.importing.convert import import_recordings
from tests.helpers.paths import GOLDEN, REAL

ROBOTS: Mapping[str, tuple[Path, str]] = {
    "ur5": (GOLDEN / "robots/ur5.urdf", ""),
    "ur10": (real.ROBOTS["ur10"][0], ""),
    "panda": (real.ROBOTS["panda"][0], "panda_joint"),
    "med7": (real.ROBOTS["med7"][0], ""),
    "kinova_gen3": (real.ROBOTS["kinova_gen3"][0], ""),
    "tx40": (real.ROBOTS["tx40"][0], ""),
    "jaco2": (REAL / "kinova_description/robots/kinova.urdf", ""),
    "xarm7": (REAL / "xarm_description/urdf/xarm7.urdf", ""),
    "z1": (REAL / "z1_description/urdf/z1.urdf", "joint[1-6]"),
    "stanford": (GOLDEN / "robots/stanford.urdf", ""),
    "tiago": (REAL / "tiago_description/robots/tiago_no_hand.urdf", "arm_"),
    "baxter": (REAL / "baxter_description/urdf/baxter.urdf", "left_[sew]"),
    "g1": (REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf", "left_(shoulder|elbow|wrist)"),
}
"""Model files, and a pattern of the joints that move: industrial arms, a slider, humanoids."""

MOUNTS: Mapping[str, Sequence[float]] = {
    "level": (0, 0, -1), "ceiling": (0, 0, 1), "wall +x": (1, 0, 0), "wall -x": (-1, 0, 0),
    "wall +y": (0, 1, 0), "wall -y": (0, -1, 0),
}  # fmt: skip
"""Direction of gravity; besides, "inclined 30" by degrees about a random horizontal axis."""

COMPENSATED = {"compensated": 1.0, "compensated by half": 0.5, "compensated by file": 0.0}
"""Part of gravity's torque that the drives leave out; of the model file's bodies all of it."""

ALL = ("position", "velocity", "torque")
MISTAKES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "zero 90": ("offset", ALL[:1]), "zero 180": ("offset", ALL[:1]),
    "zero first": ("offset", ALL[:1]), "reversed": ("sign", ALL), "exchanged": ("columns", ALL),
    "reversed position": ("sign", ALL[:2]), "exchanged positions": ("columns", ALL[:2]),
    "torque sign": ("sign", ALL[2:]), "torque sign all": ("sign", ALL[2:]),
    "exchanged torques": ("columns", ALL[2:]), "factor": ("gain", ALL[2:]),
}  # fmt: skip
"""Key that a mapping has wrong, and in which tables."""

LATE = ("late 2", "late 5", "late 8", "late 12", "late 17", "late 20", "low pass 5", "low pass 10",
        "low pass 20", "low pass 50")  # fmt: skip
"""Delays and time constants [ms]."""

CASES: Mapping[str, Sequence[tuple[str, str]]] = {
    "mount": [(mount, "nothing") for mount in (*MOUNTS, "inclined 45", "inclined 30", "inclined 3",
                                               "inclined 1", *COMPENSATED)],
    "fault": [("level", fault) for fault in (*MISTAKES, "wrap", "plateau", "load friction",
                                             "stribeck")],
    "delay": [("level", fault) for fault in LATE],
    "other": [(mount, fault) for mount in ("level", "ceiling", "inclined 3")
              for fault in ("spring", "heavy link", "leaning")],
}  # fmt: skip
"""How a simulated robot is mounted and what is wrong besides, by kind."""

KINDS = (*CASES, "real")

FACTOR = 1.4
"""By which three gains are wrong."""

RATE, SECONDS = 100.0, (20.0, 30.0, 60.0)

OFF, CONSTANTS = 0.015, 0.3
"""Standard deviations of centres of mass [m], and of torque constants where torques are currents,
relative."""

TOOL, TOOLS, SENSED, CURRENTS = (0.02, 0.1), 0.5, 0.7, 1 / 3
"""Mass of a tool over the robot's; parts of the recordings with one, with velocities, of currents.
"""

NOISE, UNMODELLED, WANDER = 0.01, 0.015, 0.3
"""White noise, and rms of what wanders, ripples and comes from each neighbour, over a torque's;
time constant of what wanders [s]."""


@dataclass(frozen=True, eq=False)
class Planted:
    """A recording with something wrong.

    Attributes:
        robot: Its name.
        kind: Of what is wrong.
        what: That, in words; "nothing" where nothing is.
        tree: The robot by its file, in the gravity that the check is told.
        real: What was measured, without errors of the mapping.
        told: The mapping that the check gets.
        right: The true mapping, with gravity and delay.
        removed: Whether the torques lack the gravity of the file's bodies.
    """

    robot: str
    kind: str
    what: str
    tree: tb.Tree
    real: tb.Recording
    told: dict[str, Any]
    right: dict[str, Any]
    removed: bool = False

    @property
    def level(self) -> bool:
        """Whether what the check is told of gravity is true."""
        return bool(np.allclose(self.right["gravity"], self.tree.gravity)) and not self.removed


@cache
def _model(name: str) -> tuple[tb.Tree, tuple[str, ...]]:
    """A robot by its file, and the joints that are held at zero."""
    path, pattern = ROBOTS[name]
    joints = ElementTree.parse(path).getroot().iterfind("joint")
    moving = [str(joint.get("name")) for joint in joints if joint.get("type") != "fixed"]
    held = tuple(each for each in moving if not re.search(pattern, each))
    return tb.load_tree(path, lock=dict.fromkeys(held, 0.0)), held


def simulated(name: str, kind: str, mount: str, fault: str, seed: int) -> Planted:
    """A recording that Pinocchio made.

    Args:
        name: One of `ROBOTS`.
        kind: Of what is wrong.
        mount: Of a pair of `CASES`.
        fault: The same.
        seed: Of all of it.
    """
    rng = np.random.default_rng([seed, zlib.crc32(f"{name} {mount} {fault}".encode())])
    tree, held = _model(name)
    q, qd, qdd = _motion(tree, rng, fault)
    gravity = 9.81 * _direction(mount, rng)
    file, model = (
        on_a_free_base(real_robot(ROBOTS[name][0], held, rng, rough, off))
        for rough, off in ((0.0, 0.0), (rng.uniform(0.15, 0.3), OFF))
    )
    _bodies(model, tree.names, fault, rng)
    file.gravity.linear = model.gravity.linear = gravity
    torque = inverse(model, tree.names, q, qd, qdd)[0]
    part = COMPENSATED.get(mount, 0.0)
    removed = mount == "compensated by file"
    if mount in COMPENSATED:
        static = inverse(file if removed else model, tree.names, q, 0 * qd, 0 * qd)[0]
        torque -= (1.0 if removed else part) * static
    torque = _measured(torque, q, qd, fault, rng)
    constants = np.ones(tree.n)
    if rng.random() < CURRENTS:
        constants = np.exp(CONSTANTS * rng.normal(size=tree.n))
    position = np.round(q / ENCODER) * ENCODER
    if fault == "wrap":
        position[:, -2] = (position[:, -2] + np.pi) % (2 * np.pi) - np.pi
    top = np.abs(qd).max(axis=0)
    velocity = qd + 0.004 * top * rng.normal(size=q.shape) if rng.random() < SENSED else None
    time = np.arange(len(q)) / RATE
    recording = tb.Recording(tree.names, time, position, torque / constants, velocity=velocity)
    delay = _number(fault) * 1e-3 if fault in LATE else 0.0
    right = mapping_of(tree, recording)
    if fault == "factor" or (constants != 1).any():
        right["torque"] |= {"unit": ["A"] * tree.n, "gain": [1.0] * tree.n}
    told = right if fault not in MISTAKES else _with_mistake(tree, right, fault, rng, range(tree.n))
    right = {**right, "gravity": ((1 - part) * gravity).tolist()}
    right["torque"] = {**right["torque"], "delay": delay}
    if "gain" in right["torque"]:
        right["torque"]["gain"] = constants.tolist()
    what = {"mount": mount, "other": f"{mount}, {fault}"}.get(kind, fault)
    return Planted(name, kind, what, tree, recording, told, right, removed)


def _number(words: str) -> float:
    """The last of some words."""
    return float(words.rpartition(" ")[2])


def _direction(mount: str, rng: np.random.Generator) -> Array:
    """Of gravity, (3,)."""
    if mount in MOUNTS or mount in COMPENSATED:
        return np.array(MOUNTS.get(mount, MOUNTS["level"]), float)
    about, angle = rng.uniform(0, 2 * np.pi), np.deg2rad(_number(mount))
    turn = Rotation.from_rotvec(angle * np.array([np.cos(about), np.sin(about), 0]))
    return np.asarray(turn.apply(MOUNTS["level"]))


def _motion(tree: tb.Tree, rng: np.random.Generator, fault: str) -> tuple[Array, Array, Array]:
    """Positions, velocities, accelerations, (M, n) each: eight sines within the ranges."""
    t = np.arange(0, rng.choice(SECONDS), 1 / RATE)
    low, high = np.clip([joint.position_range for joint in tree.joints], -2.5, 2.5).T
    order = np.arange(1, 9)
    size = rng.normal(size=(tree.n, 8)) / order**0.7
    most = np.minimum(0.42 * (high - low), rng.uniform(0.6, 1.6, tree.n))
    size *= (most / np.abs(size).sum(axis=1))[:, None]
    middle = (low + high) / 2 + rng.uniform(-1, 1, tree.n) * ((high - low) / 2 - most)
    if fault == "wrap":
        middle[-2] = np.pi
    wave = np.array(0.1 * np.pi * order * rng.normal(1, 0.03, size.shape))
    phase = np.array(rng.uniform(0, 2 * np.pi, size.shape))
    return states(middle, size, phase, wave, t)


def _bodies(model: pin.Model, names: Sequence[str], fault: str, rng: np.random.Generator) -> None:
    """Put a tool onto the last body of every other robot; make one body heavy."""
    joints = [model.getJointId(name) for name in names]
    total = sum(model.inertias[k].mass for k in joints)
    if fault == "heavy link":
        k = joints[rng.integers(1, len(joints))]
        body = model.inertias[k]
        model.inertias[k] = pin.Inertia(4 * body.mass, body.lever, 4 * body.inertia)
    if rng.random() < TOOLS:
        mass = rng.uniform(*TOOL) * total
        spread = mass * 0.03**2 * np.eye(3)
        model.inertias[joints[-1]] += pin.Inertia(mass, 0.05 * rng.normal(size=3), spread)


def _measured(torque: Array, q: Array, qd: Array, fault: str, rng: np.random.Generator) -> Array:
    """Torques as drives report them, from those of the bodies, (M, n)."""
    n = torque.shape[1]
    rms = np.sqrt((torque**2).mean(axis=0))
    size = np.maximum(rms, 0.05 * rms.max())
    found = torque + _friction(torque, qd, size, fault, rng)
    if fault == "spring":  # a cable at the first joint
        found[:, 0] += rng.uniform(0.03, 0.12) * rms.max() * (q[:, 0] - q[:, 0].mean())
    if fault == "leaning":  # a person, for three seconds
        k = int(rng.uniform(0.2, 0.7) * len(found))
        found[k : k + round(3 * RATE)] += 0.3 * size * rng.normal(size=n)
    wander = _low_pass(rng.normal(size=found.shape), WANDER)
    wander /= wander.std(axis=0)
    ripple = np.sin(q * rng.integers(2, 12, n) + rng.uniform(0, 6, n))
    felt = UNMODELLED / 2 * rng.normal(size=(2, n))
    beside = np.zeros_like(found)
    beside[:, :-1] += found[:, 1:] * felt[0, 1:]
    beside[:, 1:] += found[:, :-1] * felt[1, :-1]
    found += UNMODELLED * size * (wander + ripple) + beside
    if fault.startswith("late"):
        found = _late(found, RATE, _number(fault) * 1e-3)
    if fault.startswith("low pass"):
        found = _low_pass(found, _number(fault) * 1e-3)
    found += NOISE * size * rng.normal(size=found.shape)
    if fault == "plateau":
        for k in np.argsort(-rms)[:2]:
            top = np.quantile(np.abs(found[:, k]), 0.8)
            found[:, k] = np.clip(found[:, k], -top, top)
    return found


def _friction(torque: Array, qd: Array, size: Array, fault: str, rng: np.random.Generator) -> Array:
    """Coulomb, viscous and constant parts, and by fault of the load or Stribeck's, (M, n)."""
    top = np.abs(qd).max(axis=0)
    part = rng.uniform(0.05, 0.25) * size * np.exp(0.4 * rng.normal(size=len(size)))
    sense = np.tanh(qd / (0.01 * top))
    stribeck = np.exp(-((qd / (0.1 * top)) ** 2)) if fault == "stribeck" else 0.0
    load = 0.15 * np.abs(torque) * sense if fault == "load friction" else 0.0
    offset = 0.02 * size * rng.normal(size=len(size))
    return np.asarray(part * (sense * (1 + stribeck) + qd / top) + load + offset)


def _low_pass(values: Array, constant: float) -> Array:
    """Of first order, at rest in the first sample; `constant` [s]."""
    keep = np.exp(-1 / RATE / constant)
    return np.asarray(lfilter([1 - keep], [1, -keep], values, axis=0, zi=keep * values[:1])[0])


def _late(values: Array, rate: float, delay: float) -> Array:
    """Samples of a signal so much earlier, (M, k); `rate` [Hz], `delay` [s]."""
    k = np.arange(len(values))
    return np.stack([np.interp(k - delay * rate, k, each) for each in values.T], axis=1)


def _with_mistake(
    tree: tb.Tree, right: dict[str, Any], fault: str, rng: np.random.Generator, among: Sequence[int]
) -> dict[str, Any]:
    """A mapping that says one thing wrongly, of joints among some."""
    key, tables = MISTAKES[fault]
    inner = [k for k in among if tree.joints[k].revolute and 0 < k < tree.n - 1]
    pairs = combinations([k for k in sorted(among) if k < tree.n - 1], 2)
    alike = [pair for pair in pairs if len({tree.joints[k].kind for k in pair}) == 1]
    pair = [*alike[rng.integers(len(alike))]]
    hit: Mapping[str, Any] = {
        "zero first": [0], "torque sign": [rng.choice(among)], "torque sign all": [*range(tree.n)],
        "reversed": [rng.choice([0, *inner])], "reversed position": [rng.choice([0, *inner])],
        "factor": rng.choice(among, 3, replace=False),
    }  # fmt: skip
    joints = hit.get(fault, [rng.choice(inner)])
    angle = np.pi if fault == "zero 180" else rng.choice([-1, 1]) * np.pi / 2
    wrong = {**right}
    for table in (each for each in tables if each in right):
        values = np.array(right[table][key], object)
        if key == "columns":
            values[pair] = values[pair[::-1]]
        elif key == "offset":
            values[joints] += angle
        else:
            values[joints] *= FACTOR if key == "gain" else -1
        wrong[table] = {**right[table], key: values.tolist()}
    return wrong


RECORDED = [(name, k) for name, (_, files) in real.ROBOTS.items() if "plate" not in name
            for k in range(len(files))]  # fmt: skip
"""Robots of `real.ROBOTS` whose torques were recorded, and which of their recordings."""

PARTS = {"nothing": (0, 1), "nothing, first half": (0, 0.5), "nothing, second half": (0.5, 1)}

TOLD = {"up": (0, 0, 9.81), "along x": (9.81, 0, 0), "along y": (0, 9.81, 0),
        "30 deg off": (4.905, 0, -8.4957), "3 deg off": (0.5134, 0, -9.7966)}  # fmt: skip
"""Gravity that the check is told wrongly [m/s^2]."""

REAL_FAULTS = (*PARTS, *TOLD, "late 20", "torque sign", "torque sign all", "exchanged torques",
               "reversed", "zero 90", "zero 180", "exchanged")  # fmt: skip

LARGEST = 4
"""Joints of a real robot that are hit are among so many with the largest torques."""


@cache
def _recorded(name: str, which: int) -> tuple[tb.Tree, tb.Recording]:
    """A real robot by its file, joints at rest held, and a recording of it."""
    path, mappings = real.ROBOTS[name]
    (piece, *_), _ = import_recordings(mappings[which])
    file, motion, _ = tb.hold_still(ModelFile(path), piece)
    tree = file.tree()
    return tree, motion.part(0, motion.samples).ordered(tree)


def measured(name: str, which: int, fault: str, seed: int) -> Planted:
    """A real recording, as it is or with a mistake.

    Args:
        name: A robot's, with `which` one of `RECORDED`.
        which: Of its recordings.
        fault: One of `REAL_FAULTS`.
        seed: Of the joints that are hit.
    """
    rng = np.random.default_rng([seed, which, zlib.crc32(f"{name} {fault}".encode())])
    tree, whole = _recorded(name, which)
    first, last = (round(share * whole.samples) for share in PARTS.get(fault, (0, 1)))
    part = whole.part(first, last)
    torque = part.measured("torque")
    right = mapping_of(tree, part)
    largest = np.argsort(-(torque**2).mean(axis=0))[:LARGEST].tolist()
    told = _with_mistake(tree, right, fault, rng, largest) if fault in MISTAKES else right
    right = {**right, "gravity": tree.gravity.tolist()}
    if fault.startswith("late"):
        delay = _number(fault) * 1e-3
        part = replace(part, torque=_late(torque, 1 / float(np.diff(part.time).mean()), delay))
        right["torque"] = {**right["torque"], "delay": delay}
    robot = f"{name} {which + 1}" if which else name
    return Planted(robot, "real", fault, tree.with_gravity(TOLD.get(fault)), part, told, right)


def cases(names: Sequence[str], kinds: Sequence[str], seed: int) -> list[Callable[[], Planted]]:
    """Makers of all recordings, in random order.

    Args:
        names: Of robots.
        kinds: Of what is wrong, of `KINDS`.
        seed: Of all of it.
    """
    found: list[Callable[[], Planted]] = [
        partial(simulated, name, kind, *case, seed)
        for kind in kinds for name in ROBOTS if name in names for case in CASES.get(kind, ())
    ]  # fmt: skip
    found += [
        partial(measured, name, which, fault, seed)
        for name, which in RECORDED if name in names and "real" in kinds for fault in REAL_FAULTS
    ]  # fmt: skip
    return [found[k] for k in np.random.default_rng(seed).permutation(len(found))]
