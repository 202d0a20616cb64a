"""Shapes of a URDF robot, through Pinocchio."""

from __future__ import annotations

import time
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from testbed.bodies.shapes.shapes import DrawnShapes, Kind, Shape
from testbed.core.base.arrays import Array
from testbed.core.base.child_process import Returned, call_in_child
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import WIDTH, ModelError, few
from testbed.core.robot.asset_files import blocking
from testbed.core.robot.formats.urdf_xml import rewrite_numbers, supported_xml
from testbed.core.robot.model_file import find_mesh
from testbed.core.robot.parsing import capture_stderr
from testbed.core.robot.tree import ModelSource, Tree

PATIENCE = 60.0
"""For finding the meshes that cannot be read [s]."""
_GREY = np.array([0.7, 0.72, 0.75, 1.0])
_PARTS = ("size", "position", "rotation", "colour", "vertices", "faces")
"""Of a shape, as a child returns them."""


def read_shapes(model_file: ModelSource, tree: Tree) -> DrawnShapes:
    """The file's visual elements; mesh files are looked for beside the file and above it.

    Arguments are those of `load_shapes`.

    Raises:
        ModelError: Pinocchio refuses the shapes.
    """
    path = model_file.path
    root, _ = supported_xml(model_file, keep_visuals=True)
    lost: list[str] = []
    missing = [
        each for link in root.findall("link") for each in _prepared(link, path, lost)
    ]
    if lost:
        missing.append(diagnose("model.mesh-missing", few(lost, WIDTH)))
    coloured = root.find("link/visual/material") is not None
    root.set("version", "1.2")  # capsules are new in it
    try:
        shapes = _read(path, root, tree, coloured)
    except ModelError:  # a mesh that cannot be read, as a rule
        visuals = [
            (link, visual)
            for link in root.iter("link")
            for visual in link.iter("visual")
        ]
        alone = [_alone(visual) for _, visual in visuals]
        faults = _faults(path, alone, time.monotonic() + PATIENCE)
        for (link, visual), fault in zip(visuals, faults, strict=True):
            if fault:
                link.remove(visual)
                mesh = visual.find("geometry/mesh")
                what = (
                    "a shape" if mesh is None else f"mesh file '{mesh.get('filename')}'"
                )
                missing.append(
                    diagnose(
                        "model.shape",
                        f"{what} of link '{link.get('name')}'",
                        reason=fault,
                    )
                )
        shapes = _read(path, root, tree, coloured)
    return DrawnShapes(shapes, tuple(missing))


def _read(
    path: Path, root: ET.Element, tree: Tree, coloured: bool
) -> tuple[Shape, ...]:
    """Shapes as Pinocchio and its libraries read them; where there are meshes, in a child."""
    text = ET.tostring(root, encoding="unicode")
    if root.find("link/visual/geometry/mesh") is None:
        said, arrays = read_visuals(str(path), [text])
    else:
        said, arrays = call_in_child(
            READING, str(path), [text], file=path, error=ModelError
        )
    if fault := said["faults"][0]:
        raise ModelError(f"{path}: {fault}")
    found = []
    for k, (joint, kind) in enumerate(said["shapes"]):
        parts = {part: arrays[f"{k} {part}"] for part in _PARTS}
        if not coloured:
            parts["colour"] = _GREY
        found.append(Shape(tree.index(joint) if joint else -1, kind, **parts))
    return tuple(found)


def read_visuals(path: str, texts: list[str]) -> Returned:
    """Visual elements of URDFs, as in a child process.

    Args:
        path: The model file, as errors of the child name it.
        texts: URDFs whose meshes have absolute names.

    Returns:
        "faults", one a text and empty where it is read; "shapes", the joint that carries each
        (empty: the bedplate) and its kind; arrays "k PART" of shape k.
    """
    del path
    faults: list[str] = []
    said: list[tuple[str, str]] = []
    arrays: dict[str, NDArray[np.float64]] = {}
    for text in texts:
        faults.append("")
        try:
            model, seen = _built(text)
        except Exception as error:  # Pinocchio raises whatever a mesh makes it meet
            faults[-1] = " ".join(str(error).split()) or type(error).__name__
            continue
        for shape in seen.geometryObjects:
            joint = shape.parentJoint
            place = (
                shape.placement.translation,
                shape.placement.rotation,
                shape.meshColor,
            )
            for kind, *form in _drawn(shape.geometry):
                parts = zip(_PARTS, (form[0], *place, *form[1:]), strict=True)
                arrays |= {
                    f"{len(said)} {part}": np.array(value) for part, value in parts
                }
                said.append((model.names[joint] if joint else "", kind))
    return {"faults": faults, "shapes": said}, arrays


READING = f"{__name__}:{read_visuals.__name__}"
"""Name of `read_visuals` for a child process."""


def _faults(path: Path, texts: list[str], until: float) -> list[str]:
    """The same for all of them; those with which a child dies are found by halving.

    Args:
        path: The model file.
        texts: One a visual.
        until: When to give up, by the monotonic clock [s].
    """
    left = until - time.monotonic()
    if left <= 0:
        return ["other meshes took too long"] * len(texts)
    shortest = min(left, PATIENCE / 3)
    try:
        said, _ = call_in_child(
            READING, str(path), texts, file=path, error=ModelError, seconds=shortest
        )
    except ModelError as error:
        half = len(texts) // 2
        if not half:
            return [str(error).removeprefix(f"{path}: ")] * len(texts)
        return _faults(path, texts[:half], until) + _faults(path, texts[half:], until)
    faults: list[str] = said["faults"]
    return faults


def _alone(visual: ET.Element) -> str:
    """A URDF of one visual."""
    robot = ET.Element("robot", name="one", version="1.2")
    ET.SubElement(robot, "link", name="one").append(visual)
    return ET.tostring(robot, encoding="unicode")


def _built(text: str) -> tuple[pin.Model, pin.GeometryModel]:
    """The robot, and what there is to see of it."""
    with capture_stderr() as said, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = pin.buildModelFromXML(text)
        seen = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL, "")
        if said():  # a link with one visual that is not understood loses all of them
            raise ValueError(said())
        return model, seen


def _drawn(form: object) -> Iterator[tuple[Kind, Array, Array, Array]]:
    """Kind, size, vertices and faces of Coal's geometry; what it cannot be is left out."""
    none = np.zeros((0, 3))
    if isinstance(form, coal.Box):
        yield "box", np.array(form.halfSide).ravel(), none, none
    elif isinstance(form, coal.Sphere):
        yield "ellipsoid", np.repeat(form.radius, 3), none, none
    elif isinstance(form, coal.Cylinder | coal.Capsule):
        kind: Kind = "cylinder" if isinstance(form, coal.Cylinder) else "capsule"
        yield kind, np.array([form.radius, form.halfLength]), none, none
    elif isinstance(form, coal.BVHModelBase):
        faces = [
            [triangle[c] for c in range(3)]
            for triangle in map(form.tri_indices, range(form.num_tris))
        ]
        if faces:
            yield (
                "mesh",
                np.zeros(0),
                np.array(form.vertices()),
                np.array(faces, dtype=float),
            )


def _prepared(link: ET.Element, path: Path, lost: list[str]) -> Iterator[Diagnostic]:
    """Make numbers plain and mesh names absolute; names visuals that are no shapes.

    Args:
        link: Of the model; visuals that cannot be drawn are removed.
        path: The model file.
        lost: Mesh files that are not found are added to it.
    """
    owner = f"link '{link.get('name')}'"
    for visual in link.findall("visual"):
        try:
            for holder in (
                visual,
                *visual.findall("geometry"),
                *visual.findall("material"),
            ):
                rewrite_numbers(holder, f"{path.name}: visual of {owner}")
        except ModelError as error:
            link.remove(visual)
            yield diagnose("model.shape", f"a visual of {owner}", reason=error)
            continue
        mesh = visual.find("geometry/mesh")
        if mesh is not None:
            name = mesh.get("filename", "")
            found = find_mesh(name, path)
            if found is None:
                link.remove(visual)
                lost.append(f"mesh file '{name}' of {owner}")
            elif fault := blocking(found[1]):
                link.remove(visual)
                yield diagnose(
                    "model.shape", f"mesh file '{name}' of {owner}", reason=fault
                )
            else:
                mesh.set("filename", str(found[1]))
