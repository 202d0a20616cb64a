"""Everything that a model file refers to, and a copy of it all that needs nothing else."""

from __future__ import annotations

import os
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from testbed.robot.load import model_format
from testbed.robot.model_xml import read_xml
from testbed.robot.visuals.mesh_files import find_mesh

ENDINGS = {
    ".xml", ".mjcf", ".urdf", ".stl", ".obj", ".dae", ".ply", ".msh", ".off", ".glb", ".gltf",
    ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".hf", ".skn", ".bin", ".mtl",
}  # fmt: skip
"""Of files that a model may bring along; whatever else it names stays where it is."""


def copy_model(path: Path, folder: Path) -> Path:
    """Copy a model file with all that it refers to.

    The files keep their places relative to each other, so that the copy finds them; what is
    missing is left out, as it is when the model is read.

    Args:
        path: The model file.
        folder: Where to; made if it is not there.

    Returns:
        The copy of the model file.

    Raises:
        ModelError: The model file cannot be read.
    """
    path = path.resolve()
    held = held_files(path)
    root = Path(os.path.commonpath([path.parent, *held.values(), *(f.parent for f in held)]))
    for file in (path, *held):
        place = folder / file.relative_to(root)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)
    return folder / path.relative_to(root)


def held_files(path: Path) -> dict[Path, Path]:
    """Files that a model refers to, and the folder from which their names lead there.

    Args:
        path: The model file.

    Raises:
        ModelError: The model file cannot be read.
    """
    found = _of_mjcf(path) if model_format(path) == "mjcf" else _of_urdf(path)
    return {file: place for file, place in found if file.suffix.lower() in ENDINGS}


def _of_urdf(path: Path) -> Iterator[tuple[Path, Path]]:
    for mesh in read_xml(path).iterfind("link/visual/geometry/mesh"):
        found = find_mesh(mesh.get("filename", ""), path)
        if found is not None:
            place, file = found
            yield Path(os.path.normpath(file)), place


def _of_mjcf(path: Path) -> Iterator[tuple[Path, Path]]:
    waiting, seen, assets = [path], {path}, {""}
    while waiting:
        here = waiting.pop()
        root = read_xml(here)
        assets |= set(_asset_folders(root))
        folders = {place / name for place in (path.parent, here.parent) for name in assets}
        for name in _names(root):
            for folder in folders:
                file = Path(os.path.normpath(folder / name))
                if file in seen or not file.is_file():
                    continue
                seen.add(file)
                yield file, folder.resolve()
                if file.suffix.lower() in (".xml", ".mjcf"):
                    waiting.append(file)


def _asset_folders(root: ET.Element) -> Iterator[str]:
    for compiler in root.iter("compiler"):
        for key in ("meshdir", "texturedir", "assetdir"):
            yield compiler.get(key, "")


def _names(root: ET.Element) -> Iterator[str]:
    """Names of files, whatever the element."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if key.startswith("file") and value:
                yield value
