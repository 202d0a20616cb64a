"""What is read of model files: joints, bodies, shapes, warnings and minimal sets, as approved."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.parameters.rules import Model
from testbed.robot.free_base import on_free_base
from testbed.robot.model_file import ModelFile
from testbed.robot.visuals.appearance import load_appearance
from tests.helpers.approved import hold, numbers
from tests.helpers.paths import GOLDEN, REAL, ROOT

pytestmark = pytest.mark.slow

FINGERS: Mapping[str, float | None] = dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"))
FILES = {
    "puma": ModelFile(ROOT / "models/puma562.xml"),
    "puma_urdf": ModelFile(ROOT / "models/puma562.urdf"),
    "held": ModelFile(ROOT / "models/puma562.xml", lock={"shoulder": 0.5}),
    "panda": ModelFile(REAL / "panda_description/urdf/panda.urdf", lock=FINGERS),
    "ur10": ModelFile(REAL / "ur_description/urdf/ur10_robot.urdf"),
    "kinova": ModelFile(REAL / "kinova_description/robots/kinova.urdf"),
    "solo": ModelFile(REAL / "solo_description/robots/solo12.urdf", weld_root=True),
    "double": ModelFile(REAL / "double_pendulum_description/urdf/double_pendulum.urdf"),
    "humanoid": ModelFile(GOLDEN / "robots/humanoid_pelvis.urdf"),
    "stanford": ModelFile(GOLDEN / "robots/stanford.urdf"),
    "tx40": ModelFile(ROOT / "examples/tx40/tx40.urdf"),
}


KINDS: tuple[Model, ...] = ("dynamic", "reaction")


def of_tree(tree: tb.Tree) -> list[str]:
    lines = [repr(tree), f"gravity {numbers(tree.gravity)}, floating {tree.floating}"]
    lines += [f"warning: {line}" for line in tree.warnings]
    bodies = zip(tree.joints, tree.inertias, strict=True)
    for joint, inertia in ((None, tree.pedestal), *bodies):
        if joint is not None:
            place = f"{joint.name}: {joint.kind} on {joint.parent}, body {joint.body}"
            lines.append(f"{place}, axis {numbers(joint.axis)}, at {numbers(joint.offset)}")
            lines.append(f"  turned {numbers(joint.rotation)}")
            lines.append(
                f"  range {numbers(joint.position_range)}, limits {joint.max_velocity:.6g} "
                f"{joint.max_effort:.6g}, coulomb {joint.coulomb:.6g}, viscous "
                f"{joint.viscous:.6g}, rotor {joint.rotor_inertia:.6g}"
            )
        values = (numbers(np.asarray(value)) for value in vars(inertia).values())
        lines.append(f"  inertia: {', '.join(values)}")
    return lines


def of_appearance(tree: tb.Tree, model: ModelFile) -> list[str]:
    look = load_appearance(tree, model)
    lines = [f"not shown: {line.replace(str(REAL), '')}" for line in look.warnings]
    for shape in look.shapes:
        place = f"{numbers(shape.position)}, turned {numbers(shape.rotation)}"
        lines.append(f"{shape.body} {shape.kind} {numbers(shape.size)} at {place}")
        lines.append(f"  {numbers(shape.colour)}, {shape.vertices.shape} {shape.faces.shape}")
    return lines


@pytest.mark.parametrize("name", FILES)
def test_a_robot_is_read_as_approved(name: str) -> None:
    model = FILES[name]
    tree = model.tree()
    lines = [*of_tree(tree), *of_appearance(tree, model)]
    for kind in KINDS:
        found = tb.minimal_set(tree, kind)
        lines += [f"{found!r}", f"never {found.never}, axial {found.axial}"]
        each = zip(found.names, found.units, found.bodies, found.reasons, strict=True)
        lines += [f"  {' '.join(map(str, one))}" for one in each]
        lines.append(f"  values {numbers(found.values(tb.barycentric(tree)))}")
    free = on_free_base(tree)
    lines.append(f"on a free base: {tb.minimal_set(free, 'reaction').count}")
    text = "\n".join(lines).replace(str(Path(model.path).parent), "")
    hold(f"tree_{name}.txt", text + "\n")
