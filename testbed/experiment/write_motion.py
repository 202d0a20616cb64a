"""Writing a designed motion to a file, with what is proven and what it promises."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.excitation.limits import Limits
from testbed.experiment.excite import Excitation
from testbed.experiment.versions import versions
from testbed.files import fingerprint, replacing

_HEAD = """\
# A motion, made by testbed {version}, excite.
# q_j(t) = offset + sum over k = 1, 2, ... of sine_k sin(k w t) + cosine_k cos(k w t),
# w = 2 pi fundamental; rad or m, joint side. To run it: file = "this file" under [motion].
"""


def write_motion(path: Path, found: Excitation) -> None:
    """Write a motion.

    Args:
        path: The file; what stands there is replaced.
        found: The motion, its proof, and what it promises.
    """
    design, predicted, tree = found.design, found.predicted, found.tree
    model, limits = Path(found.experiment.model), found.rules.limits
    motion = design.motion
    named = os.path.relpath(model.resolve(), path.resolve().parent)
    lines = [
        _HEAD.format(version=versions()["testbed"]),
        f"model = {json.dumps(Path(named).as_posix())}",
        f"model_sha256 = {json.dumps(fingerprint(model))}",
        f"fundamental = {motion.fundamental!r}  # Hz",
    ]
    for j, name in enumerate(tree.names):
        lines += ["", f"[joint.{json.dumps(name)}]", f"offset = {float(motion.offset[j])!r}"]
        lines += [f"sine = {_list(motion.sine[j])}", f"cosine = {_list(motion.cosine[j])}"]
    lines += ["", "[limits]  # rad or m, and per s, per s^2; N m or N"]
    lines += [f"{json.dumps(name)} = {_limit(limits, j)}" for j, name in enumerate(tree.names)]
    lines += ["", "[predicted]  # standard deviation of each parameter as a share of its value"]
    pairs = zip(predicted.names, predicted.relative, strict=True)
    lines += [f"{json.dumps(name)} = {float(share):.4g}" for name, share in pairs]
    for margin in design.proof.margins:
        lines += ["", "[[proof]]  # what is left of what may be used, at every moment"]
        lines += [f"limit = {json.dumps(margin.label)}", f"left = {margin.left:.6g}"]
        lines += [f'unit = "{margin.unit or "share"}"', f"instant = {margin.instant:.6g}  # s"]
    with replacing(path) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _list(values: Array) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _limit(limits: Limits, joint: int) -> str:
    low, high = float(limits.low[joint]), float(limits.high[joint])
    parts = [f"position = [{low!r}, {high!r}]", f"velocity = {float(limits.velocity[joint])!r}"]
    parts.append(f"acceleration = {float(limits.acceleration[joint])!r}")
    if np.isfinite(limits.effort[joint]):
        parts.append(f"effort = {float(limits.effort[joint])!r}")
    return "{ " + ", ".join(parts) + " }"
