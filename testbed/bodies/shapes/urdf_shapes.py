"""Visual shapes of a URDF robot, read with Pinocchio."""

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

from testbed.bodies.shapes.shapes import Shape, ShapeKind, VisualShapes
from testbed.core.base.arrays import Array
from testbed.core.base.child_process import ChildResult, call_in_child
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import MAX_LIST_WIDTH, ModelError, shortened_list
from testbed.core.robot.asset_files import blocking_reason
from testbed.core.robot.formats.urdf_xml import checked_urdf_xml, rewrite_numbers
from testbed.core.robot.model_file import find_mesh
from testbed.core.robot.parsing import capture_stderr
from testbed.core.robot.tree import ModelSource, Tree

SEARCH_TIMEOUT = 60.0
"""Time limit of the search for meshes that cannot be read [s]."""
_GREY = np.array([0.7, 0.72, 0.75, 1.0])
_ARRAY_FIELDS = ("size", "position", "rotation", "colour", "vertices", "faces")
"""Array fields of a shape, as a child process returns them."""


def read_shapes(model_file: ModelSource, tree: Tree) -> VisualShapes:
    """Read the visual elements of a URDF file.

    Mesh files are searched for in the folder of the URDF file and its parent folders. Missing or
    unreadable meshes and invalid visuals are left out and reported as diagnostics. All shapes are
    grey if no visual has a material.

    Args:
        model_file: URDF file, and the options it was read with.
        tree: Tree read from the file.

    Raises:
        ModelError: The file cannot be read, or Pinocchio rejects the other shapes.
    """
    path = model_file.path
    root, _ = checked_urdf_xml(model_file, keep_visuals=True)
    missing_files: list[str] = []
    diagnostics = [
        each
        for link in root.findall("link")
        for each in _prepare_visuals(link, path, missing_files)
    ]
    if missing_files:
        diagnostics.append(
            make_diagnostic(
                "model.mesh-missing", shortened_list(missing_files, MAX_LIST_WIDTH)
            )
        )
    coloured = root.find("link/visual/material") is not None
    root.set("version", "1.2")  # first version with capsules
    try:
        shapes = _shapes_from_urdf(path, root, tree, coloured)
    except ModelError:  # usually a mesh that cannot be read
        visuals = [
            (link, visual)
            for link in root.iter("link")
            for visual in link.iter("visual")
        ]
        texts = [_single_visual_urdf(visual) for _, visual in visuals]
        faults = _visual_faults(path, texts, time.monotonic() + SEARCH_TIMEOUT)
        for (link, visual), fault in zip(visuals, faults, strict=True):
            if fault:
                link.remove(visual)
                mesh = visual.find("geometry/mesh")
                what = (
                    "a shape" if mesh is None else f"mesh file '{mesh.get('filename')}'"
                )
                diagnostics.append(
                    make_diagnostic(
                        "model.shape",
                        f"{what} of link '{link.get('name')}'",
                        reason=fault,
                    )
                )
        shapes = _shapes_from_urdf(path, root, tree, coloured)
    return VisualShapes(shapes, tuple(diagnostics))


def _shapes_from_urdf(
    path: Path, root: ET.Element, tree: Tree, coloured: bool
) -> tuple[Shape, ...]:
    """Shapes of a URDF, read with Pinocchio.

    A URDF with meshes is read in a child process.

    Args:
        path: Model file, for messages.
        root: URDF with absolute names of the meshes.
        tree: Tree read from the file.
        coloured: True if the file has materials; otherwise the shapes are grey.

    Raises:
        ModelError: Pinocchio rejects the shapes.
    """
    text = ET.tostring(root, encoding="unicode")
    if root.find("link/visual/geometry/mesh") is None:
        records, arrays = read_visuals(str(path), [text])
    else:
        records, arrays = call_in_child(
            READ_VISUALS, str(path), [text], file=path, error=ModelError
        )
    if fault := records["faults"][0]:
        raise ModelError(f"{path}: {fault}")
    shapes = []
    for k, (joint, kind) in enumerate(records["shapes"]):
        parts = {part: arrays[f"{k} {part}"] for part in _ARRAY_FIELDS}
        if not coloured:
            parts["colour"] = _GREY
        shapes.append(Shape(tree.index(joint) if joint else -1, kind, **parts))
    return tuple(shapes)


def read_visuals(path: str, texts: list[str]) -> ChildResult:
    """Read the visual elements of several URDFs; to be called in a child process.

    Args:
        path: Model file, for errors of the child process.
        texts: URDFs with absolute names of the meshes.

    Returns:
        Records and arrays. The record "faults" contains an error message for each text, empty if
        there is no error; the record "shapes" contains the joint (empty for the bedplate) and the
        kind of each shape. The array "k FIELD" is the field FIELD of shape number k.
    """
    del path
    faults: list[str] = []
    shapes: list[tuple[str, str]] = []
    arrays: dict[str, NDArray[np.float64]] = {}
    for text in texts:
        faults.append("")
        try:
            model, geometry = _visual_model(text)
        except Exception as error:  # a mesh can raise any error in Pinocchio
            faults[-1] = " ".join(str(error).split()) or type(error).__name__
            continue
        for shape in geometry.geometryObjects:
            joint = shape.parentJoint
            place = (
                shape.placement.translation,
                shape.placement.rotation,
                shape.meshColor,
            )
            for kind, *form in _shape_arrays(shape.geometry):
                parts = zip(_ARRAY_FIELDS, (form[0], *place, *form[1:]), strict=True)
                arrays |= {
                    f"{len(shapes)} {part}": np.array(value) for part, value in parts
                }
                shapes.append((model.names[joint] if joint else "", kind))
    return {"faults": faults, "shapes": shapes}, arrays


READ_VISUALS = f"{__name__}:{read_visuals.__name__}"
"""Name of `read_visuals` for a child process."""


def _visual_faults(path: Path, texts: list[str], until: float) -> list[str]:
    """Error message of each visual, empty if there is no error.

    Visuals that crash Pinocchio are found by bisection. Visuals that are not reached before the
    deadline get an error message, too.

    Args:
        path: Model file, for messages.
        texts: URDFs of one visual each.
        until: Deadline on the monotonic clock [s].
    """
    remaining = until - time.monotonic()
    if remaining <= 0:
        return ["other meshes took too long"] * len(texts)
    timeout = min(remaining, SEARCH_TIMEOUT / 3)
    try:
        records, _ = call_in_child(
            READ_VISUALS, str(path), texts, file=path, error=ModelError, seconds=timeout
        )
    except ModelError as error:
        half = len(texts) // 2
        if not half:
            return [str(error).removeprefix(f"{path}: ")] * len(texts)
        return _visual_faults(path, texts[:half], until) + _visual_faults(
            path, texts[half:], until
        )
    faults: list[str] = records["faults"]
    return faults


def _single_visual_urdf(visual: ET.Element) -> str:
    """Text of a URDF with one link that has a single visual."""
    robot = ET.Element("robot", name="one", version="1.2")
    ET.SubElement(robot, "link", name="one").append(visual)
    return ET.tostring(robot, encoding="unicode")


def _visual_model(text: str) -> tuple[pin.Model, pin.GeometryModel]:
    """Pinocchio's model and visual geometry of a URDF.

    Args:
        text: URDF.

    Raises:
        ValueError: Pinocchio reports an error on its error stream.
    """
    with capture_stderr() as messages, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = pin.buildModelFromXML(text)
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL, "")
        if messages():  # a link with an unreadable visual loses all visuals
            raise ValueError(messages())
        return model, geometry


def _shape_arrays(form: object) -> Iterator[tuple[ShapeKind, Array, Array, Array]]:
    """Yield kind, size, vertices and faces of a Coal geometry, if its type is supported."""
    none = np.zeros((0, 3))
    if isinstance(form, coal.Box):
        yield "box", np.array(form.halfSide).ravel(), none, none
    elif isinstance(form, coal.Sphere):
        yield "ellipsoid", np.repeat(form.radius, 3), none, none
    elif isinstance(form, coal.Cylinder | coal.Capsule):
        kind: ShapeKind = "cylinder" if isinstance(form, coal.Cylinder) else "capsule"
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


def _prepare_visuals(
    link: ET.Element, path: Path, missing_files: list[str]
) -> Iterator[Diagnostic]:
    """Normalise numbers and mesh names of a link's visuals; remove and diagnose invalid visuals.

    A visual is invalid if its numbers are malformed or if its mesh file is missing or must not be
    read. Mesh names become absolute paths.

    Args:
        link: Link of the URDF, changed in place.
        path: Model file.
        missing_files: List to which the names of missing mesh files are appended.
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
            yield make_diagnostic("model.shape", f"a visual of {owner}", reason=error)
            continue
        mesh = visual.find("geometry/mesh")
        if mesh is not None:
            name = mesh.get("filename", "")
            location = find_mesh(name, path)
            if location is None:
                link.remove(visual)
                missing_files.append(f"mesh file '{name}' of {owner}")
            elif fault := blocking_reason(location[1]):
                link.remove(visual)
                yield make_diagnostic(
                    "model.shape", f"mesh file '{name}' of {owner}", reason=fault
                )
            else:
                mesh.set("filename", str(location[1]))
