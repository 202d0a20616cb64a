"""Simulated twins of real recordings: motors, a payload, a joint that hardly moves, coarse poses.

Of each group: how far the default estimate predicts another motion beside the model file, whose
masses are 15 % and centres 20 mm off and whose friction is fitted; how often intervals of 95 %
hold the truth; and the advice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

import testbed as tb
from testbed.applications.payload.torque_scales import torque_scales
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.symbols import standard, with_standard
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.views import with_base_joints
from testbed.core.robot.friction import OFFSET, SLOPE, friction_torque
from testbed.motion.fourier import Fourier
from tests.helpers.measured import measured, random_fourier
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.riding import riding

MASS, SCALES = 2.805, 0.91
"""Of the payload [kg]; of torques beside the true ones."""


@dataclass(frozen=True)
class Score:
    """Of one recording.

    Attributes:
        inside: Share of the true values within 1.96 sigma.
        error: Rms error of the prediction of another motion, relative to the signal.
        file: The same of the model file with fitted friction.
        advice: Codes of the diagnostics.
    """

    inside: float
    error: float
    file: float
    advice: tuple[str, ...]


def rough(tree: tb.Tree, rng: np.random.Generator) -> tb.Tree:
    """A robot as a file has it: masses 15 %, centres 20 mm off."""
    ten = np.array(standard(tree))
    ten *= 1 + 0.15 * rng.normal(size=(tree.n, 1))
    ten[:, 1:4] += ten[:, :1] * 0.02 * rng.normal(size=(tree.n, 3))
    return with_standard(tree, ten)


def driven(name: str, rng: np.random.Generator) -> tb.Tree:
    """A robot with friction, and rotors that weigh as much as its links."""
    path = ROOT / "examples/tx40/tx40.urdf" if name == "tx40" else GOLDEN / f"robots/{name}.urdf"
    tree = tb.load_tree(path)
    joints = [
        replace(joint, coulomb=c, viscous=v, rotor_inertia=r)
        for joint, (c, v, r) in zip(tree.joints, rng.uniform(0.5, 3, (tree.n, 3)), strict=True)
    ]
    return replace(tree, joints=tuple(joints))


def predicted(
    tree: tb.Tree, other: Recording, found: Estimate, file: tb.Tree
) -> tuple[float, float]:
    """Relative errors of another motion's torques: by an estimate, by a file with fitted friction.

    The file has the true rotors. Drift is one recording's.
    """
    assert found.drives is not None
    count, lasting = found.minimal.count, [SLOPE.kind not in name for name in found.names]
    of_file = found.drives.values(tb.barycentric(file), tree)[:count]
    again = tb.identify(tree, other, "internal", settings=found.settings).normal_equations
    left, signal = np.zeros(2), 0.0
    for channel in range(tree.n):
        normal, right, _ = found.normal_equations.of_channel(channel)
        rest = right[count:] - normal[count:, :count] @ of_file
        terms = np.linalg.lstsq(normal[count:, count:], rest, rcond=1e-12)[0]
        normal, right, square = again.of_channel(channel)
        signal += square
        for k, values in enumerate((found.values, np.append(of_file, terms))):
            x = values * lasting
            left[k] += square - 2 * right @ x + x @ normal @ x
    own, theirs = np.sqrt(np.maximum(left, 0.0) / signal).tolist()
    return own, theirs


def motors(seed: int) -> Score:
    """Torques of motors, with rotors, and offsets that drift as drives warm up."""
    rng = np.random.default_rng(seed)
    tree, whole = driven("tx40", rng), []
    offset, drift = rng.normal(size=(2, tree.n)) * [[2.0], [0.1]]
    for number in range(2):
        clean = measured(tree, 2 * seed + number)
        time = clean.time[:, None] - clean.samples / clean.rate / 2
        torque = clean.measured("torque") + offset + (1 - number) * drift * time
        facts = {"effort": dict.fromkeys(tree.names, "motor"), "mapping": {}}
        whole.append(replace(clean, torque=torque, wrench=None, tare=None, facts=facts))
    found = tb.identify(tree, whole[0], "internal", settings=tb.Settings(terms="auto"))
    assert found.drives is not None
    truth = dict(zip(found.names, found.drives.values(tb.barycentric(tree), tree), strict=True))
    for place, name in enumerate(tree.names):
        truth[f"{OFFSET.kind}/{name}"] = offset[place]
        truth[f"{SLOPE.kind}/{name}"] = drift[place]
    return _score(tree, whole[1], found, truth, rough(tree, rng))


def hardly_moving(seed: int) -> Score:
    """One joint creeps in one direction; the errors are of the recording itself."""
    rng = np.random.default_rng(seed)
    tree, still = driven("ur5", rng), int(rng.integers(1, 6))
    path = random_fourier(tree, rng, 1.0)
    share = np.ones((tree.n, 1))
    share[still] = 1e-3
    slow = Fourier(path.fundamental, path.offset, share * path.sine, share * path.cosine)
    way, offset = float(rng.choice([-1.0, 1.0])), rng.normal(size=tree.n)
    states = slow.at(np.arange(0, 20.0, 5e-3))
    q, qd = states.q.copy(), states.qd.copy()
    q[:, still] += way * 0.05 * states.t
    qd[:, still] += way * 0.05
    motion = tb.Motion(states.t, q, qd, states.qdd)
    rotors = np.array([joint.rotor_inertia for joint in tree.joints])
    torque = tb.joint_forces(tree, motion) + friction_torque(tree, qd)
    torque += rotors * motion.qdd + offset
    recording = Recording(
        tree.names, states.t, q + 1e-4 * rng.normal(size=q.shape),
        torque + 0.5 * rng.normal(size=q.shape), facts={"effort": {"j": "motor"}, "mapping": {}},
    )  # fmt: skip
    found = tb.identify(tree, recording, "internal")
    assert found.drives is not None
    truth = dict(zip(found.names, found.drives.values(tb.barycentric(tree), tree), strict=True))
    for place, name in enumerate(tree.names):
        dry = way * tree.joints[place].coulomb
        truth[f"{OFFSET.kind}/{name}"] = offset[place]
        truth |= dict.fromkeys((f"coulomb+offset/{name}", f"offset-coulomb/{name}"),
                               offset[place] + dry)  # fmt: skip
    return _score(tree, recording, found, truth, rough(tree, rng))


def _score(
    tree: tb.Tree, other: Recording, found: Estimate, truth: Mapping[str, float], file: tb.Tree
) -> Score:
    z = [(v - truth[n]) / s for n, v, s in zip(found.names, found.values, found.sigma, strict=True)]
    own, theirs = predicted(tree, other, found, file)
    return Score(float(np.mean(np.abs(z) < 1.96)), own, theirs, _codes(found))


def _codes(found: Estimate) -> tuple[str, ...]:
    return tuple(dict.fromkeys(each.code for each in found.diagnostics))


def weighed(seed: int) -> Score:
    """A payload of 2.805 kg, torques 9 % small; the error is of the payload in its own scale."""
    rng = np.random.default_rng(seed)
    tree = driven("ur5", rng)
    load = tb.Inertia.about_centre(MASS, [0.03, 0.02, 0.08], 0.01 * np.eye(3))
    heavy = replace(tree, inertias=(*tree.inertias[:-1], tree.inertias[-1] + load))
    scales = SCALES * (1 + 0.02 * rng.normal(size=tree.n))
    pair = [measured(each, 2 * seed + k) for k, each in enumerate((tree, heavy))]
    facts = {"effort": dict.fromkeys(tree.names, "current")}
    pair = [replace(r, torque=scales * r.measured("torque"), facts=facts) for r in pair]
    found = torque_scales(tree, pair[0], pair[1], {"payload/mass": MASS})
    one, other = (tb.identify(tree, each, "internal") for each in pair)
    mass = float(tb.payload(tree, one, other).values[0])
    inside = np.abs(found.values - scales) < 1.96 * found.sigma
    return Score(float(np.mean(inside)), abs(mass / MASS / SCALES - 1), 1 - SCALES, ())


def coarse(seed: int, *, follow: bool = False) -> Score:
    """A floating base at 30 Hz, every second pose that of the sample before; the plate's wrench.

    Args:
        seed: Of robot, motion and noise.
        follow: Whether repeated poses are left out, as the advice has it.
    """
    tree, fine = riding(seed)
    rng, step = np.random.default_rng(seed), 1 / 30
    time = np.arange(0, fine.time[-1], step)
    signals: dict[str, Array] = {
        s: make_interp_spline(fine.time, fine.measured(s), k=5 if s != "wrench" else 1)(time)
        for s in ("position", "base", "wrench")
    }
    for name in ("position", "base"):
        signals[name] += 1e-5 * rng.normal(size=signals[name].shape)
        shown = signals[name][::2]
        if follow:
            signals[name] = make_interp_spline(time[::2], shown, k=5)(time)
        else:
            signals[name][1::2] = shown[: len(time) // 2]
    recording = Recording(fine.names, time, tare=np.zeros(6), **signals)  # type: ignore[arg-type]
    found = tb.identify(tree, recording)
    truth = found.minimal.values(tb.barycentric(tree))
    inside = float(np.mean(np.abs(found.values - truth) < 1.96 * found.sigma))
    q = with_base_joints(fine).position
    qd = np.gradient(q, 5e-3, axis=0)
    motion = tb.Motion(fine.time, q, qd, np.gradient(qd, 5e-3, axis=0))
    rows = tb.regressor(tree, motion, found.minimal)[20:-20]
    signal = rows @ truth
    size = np.linalg.norm(signal - signal.mean(axis=0))
    file = found.minimal.values(tb.barycentric(rough(tree, rng)))
    own, theirs = (float(np.linalg.norm(rows @ (v - truth)) / size) for v in (found.values, file))
    return Score(inside, own, theirs, _codes(found))


def coarse_followed(seed: int) -> Score:
    """The same, after the advice."""
    return coarse(seed, follow=True)


GROUPS: Mapping[str, Callable[[int], Score]] = {
    "motors": motors,
    "a joint that hardly moves": hardly_moving,
    "payload": weighed,
    "coarse poses": coarse,
    "coarse poses, advice followed": coarse_followed,
}


def scores(first: int, runs: int, only: str = "") -> Iterator[dict[str, Any]]:
    """A line a group.

    Args:
        first: The first seed.
        runs: How many recordings of each.
        only: Groups whose names hold this.
    """
    for name, made in GROUPS.items():
        if only not in name:
            continue
        every = [made(seed) for seed in range(first, first + runs)]
        advice = [code for each in every for code in each.advice]
        yield {
            "group": name,
            "runs": runs,
            "inside": round(float(np.mean([each.inside for each in every])), 3),
            "error": round(float(np.median([each.error for each in every])), 4),
            "file": round(float(np.median([each.file for each in every])), 4),
            "worse": sum(each.error > each.file for each in every),
            "advice": {code: advice.count(code) for code in dict.fromkeys(advice)},
        }
