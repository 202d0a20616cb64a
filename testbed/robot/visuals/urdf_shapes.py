"""Shapes of a URDF robot, through Pinocchio."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from testbed.arrays import Array
from testbed.diagnostics import Diagnostic, diagnose
from testbed.errors import WIDTH, ModelError, few
from testbed.robot.formats.urdf_xml import rewrite_numbers, supported_xml
from testbed.robot.locks import Lock
from testbed.robot.model_file import find_mesh
from testbed.robot.parsing import capture_stderr
from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import DrawnShapes, Shape

_GREY = np.array([0.7, 0.72, 0.75, 1.0])


def read_shapes(
    path: Path, tree: Tree, *, weld_root: bool = False, lock: Lock | None = None
) -> DrawnShapes:
    """The file's visual elements; mesh files are looked for beside the file and above it.

    Arguments are those of `load_shapes`.

    Raises:
        ModelError: Pinocchio refuses the shapes.
    """
    root, _ = supported_xml(path, weld_root=weld_root, lock=lock, keep_visuals=True)
    lost: list[str] = []
    missing = [each for link in root.findall("link") for each in _prepared(link, path, lost)]
    if lost:
        missing.append(diagnose("model.mesh-missing", few(lost, WIDTH)))
    coloured = root.find("link/visual/material") is not None
    root.set("version", "1.2")  # capsules are new in it
    try:
        model, seen = _built(root)
    except Exception:  # Pinocchio raises whatever a mesh makes it meet
        missing += [each for link in root.findall("link") for each in _without_unreadable(link)]
        try:
            model, seen = _built(root)
        except Exception as error:
            raise ModelError(f"{path}: {' '.join(str(error).split())}") from None
    return DrawnShapes(tuple(_shapes(model, seen, tree, coloured)), tuple(missing))


def _shapes(
    model: pin.Model, seen: pin.GeometryModel, tree: Tree, coloured: bool
) -> Iterator[Shape]:
    for shape in seen.geometryObjects:
        joint = shape.parentJoint
        body = tree.index(model.names[joint]) if joint else -1
        colour = np.array(shape.meshColor) if coloured else _GREY
        placed = (shape.placement.translation, shape.placement.rotation, colour)
        yield from _drawn(body, shape.geometry, *placed)


def _built(root: ET.Element) -> tuple[pin.Model, pin.GeometryModel]:
    """The robot, and what there is to see of it."""
    text = ET.tostring(root, encoding="unicode")
    with capture_stderr() as said, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = pin.buildModelFromXML(text)
        seen = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL, "")
        if said():  # a link with one visual that is not understood loses all of them
            raise ValueError(said())
        return model, seen


def _drawn(
    body: int, form: object, position: Array, rotation: Array, colour: Array
) -> Iterator[Shape]:
    """Coal's geometry as ours; what it cannot be is left out."""
    if isinstance(form, coal.Box):
        yield Shape(body, "box", np.array(form.halfSide).ravel(), position, rotation, colour)
    elif isinstance(form, coal.Sphere):
        yield Shape(body, "ellipsoid", np.repeat(form.radius, 3), position, rotation, colour)
    elif isinstance(form, coal.Cylinder | coal.Capsule):
        size = np.array([form.radius, form.halfLength])
        kind = type(form).__name__.lower()
        yield Shape(body, kind, size, position, rotation, colour)  # type: ignore[arg-type]
    elif isinstance(form, coal.BVHModelBase):
        faces = [
            [triangle[c] for c in range(3)]
            for triangle in map(form.tri_indices, range(form.num_tris))
        ]
        vertices, size = np.array(form.vertices()), np.zeros(0)
        if faces:
            at = (position, rotation, colour)
            yield Shape(body, "mesh", size, *at, vertices, np.array(faces, dtype=float))


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
            for holder in (visual, *visual.findall("geometry"), *visual.findall("material")):
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
            else:
                mesh.set("filename", str(found[1]))


def _without_unreadable(link: ET.Element) -> Iterator[Diagnostic]:
    """Drop visuals that Pinocchio cannot read, each tried alone; names them."""
    for visual in link.findall("visual"):
        alone = ET.Element("robot", name="one", version="1.2")
        ET.SubElement(alone, "link", name="one").append(deepcopy(visual))
        try:
            _built(alone)
        except Exception as error:
            link.remove(visual)
            mesh = visual.find("geometry/mesh")
            what = "a shape" if mesh is None else f"mesh file '{mesh.get('filename')}'"
            said = " ".join(str(error).split())
            yield diagnose("model.shape", f"{what} of link '{link.get('name')}'", reason=said)
