"""Meshes, pictures and parts of models: which of them a copy of a model may bring along.

A model of somebody else may name any file of this machine, by its path or through a link. Only
meshes, pictures and parts of models that lie with the model, links resolved, are copied.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from testbed.core.base.errors import ModelError
from testbed.core.robot.parsing import read_xml

PARTS = (".xml", ".mjcf", ".urdf")
"""Endings of models and of what they include."""
LAYOUT = {
    "urdf",
    "mjcf",
    "xml",
    "xacro",
    "sdf",
    "robot",
    "robots",
    "model",
    "models",
    "mesh",
    "meshes",
    "asset",
    "assets",
    "visual",
    "collision",
    "texture",
    "textures",
    "material",
    "materials",
    "stl",
    "obj",
    "dae",
}
"""Names of folders that stand beside each other in a robot's description."""
MESHES = (
    ".stl",
    ".obj",
    ".dae",
    ".ply",
    ".msh",
    ".off",
    ".glb",
    ".gltf",
    ".bin",
    ".mtl",
)
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".hf", ".skn")
ENDINGS = {*PARTS, *MESHES, *PICTURES}


def asset_fault(file: Path, model: Path) -> str | None:
    """Why a file does not go into a copy of a model; None where it may.

    Args:
        file: As the model names it.
        model: The model file, links resolved.
    """
    place = file.resolve()
    for ending in (file.suffix.lower(), place.suffix.lower()):
        if ending not in ENDINGS:
            return f"its file's ending '{ending}' is of no mesh or picture"
    if not place.is_file():
        return "no regular file"
    if _beside(place, model):
        return None
    with place.open("rb") as stream:
        # bytes by which a model is recognised
        part = file.suffix.lower() in PARTS and b"<mujoco" in stream.read(4096)
    return None if part else "it lies outside of the model's package"


def blocking(file: Path) -> str | None:
    """What of a mesh file readers might wait for; None where its materials are regular files."""
    if file.suffix.lower() != ".obj":
        return None
    with file.open("rb") as lines:
        words = (line.split() for line in lines if b"mtllib" in line)
        names = [name for first, *held in words for name in held if first == b"mtllib"]
    for name in names:
        place = file.parent / os.fsdecode(name)
        if place.exists() and not place.is_file():
            return f"its material '{place.name}' is no regular file"
    return None


def _beside(file: Path, model: Path) -> bool:
    """Whether a file lies below the model's folder, in a package, or in the usual place beside."""
    home = model.parent
    if home in file.parents or any(
        (each / "package.xml").is_file() for each in file.parents
    ):
        return True
    if home.parent not in file.parents:
        return False
    return bool(
        LAYOUT & {home.name.lower(), file.relative_to(home.parent).parts[0].lower()}
    )


def mjcf_files(path: Path) -> Iterator[tuple[Path, Path]]:
    """Files that an MJCF and its parts refer to, and the folders from which their names lead there.

    Raises:
        ModelError: One is a device or a pipe, for which readers would wait.
    """
    waiting, seen, assets = [path], {path}, {""}
    while waiting:
        here = waiting.pop()
        root = read_xml(here)
        for compiler in root.iter("compiler"):
            assets |= {
                compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")
            }
        folders = {
            place / name for place in (path.parent, here.parent) for name in assets
        }
        names = [
            value
            for element in root.iter()
            for key, value in element.attrib.items()
            if key.startswith("file") and value
        ]
        for name in names:
            for folder in folders:
                file = Path(os.path.normpath(folder / name))
                if file.exists() and not (file.is_file() or file.is_dir()):
                    raise ModelError(
                        f"{path}: '{name}' is a device or pipe, no file of a model"
                    )
                if file in seen or not file.is_file():
                    continue
                seen.add(file)
                yield file, folder.resolve()
                if file.suffix.lower() in (".xml", ".mjcf"):
                    waiting.append(file)
