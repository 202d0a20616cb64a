"""Files that may be copied with a model: meshes, textures and included models.

A model file from an unknown source may refer to any file of the machine, by path or symbolic link.
Only meshes, textures and model files in the package of the model, and MJCF files elsewhere, are
copied; links are resolved before this check.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from testbed.core.base.errors import ModelError
from testbed.core.robot.parsing import read_xml

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
"""Suffixes of model files and of included files."""
PACKAGE_FOLDERS = {
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
"""Names of sibling folders in a robot description package."""
MESH_SUFFIXES = (
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
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".hf", ".skn")
ASSET_SUFFIXES = {*MODEL_SUFFIXES, *MESH_SUFFIXES, *PICTURE_SUFFIXES}


def copy_obstacle(file: Path, model: Path) -> str | None:
    """Reason not to copy a file with a model; None if the copy is allowed.

    Regular files with a suffix in ASSET_SUFFIXES are allowed inside the model's package; MJCF files
    are allowed anywhere.

    Args:
        file: File named by the model.
        model: Model file, with symbolic links resolved.
    """
    target = file.resolve()
    for ending in (file.suffix.lower(), target.suffix.lower()):
        if ending not in ASSET_SUFFIXES:
            return f"its file's ending '{ending}' is of no mesh or picture"
    if not target.is_file():
        return "no regular file"
    if _is_in_package(target, model):
        return None
    with target.open("rb") as stream:
        # bytes by which a model is recognised
        is_model = file.suffix.lower() in MODEL_SUFFIXES and b"<mujoco" in stream.read(
            4096
        )
    return None if is_model else "it lies outside of the model's package"


def blocking_reason(file: Path) -> str | None:
    """Reason why reading a mesh file could block; None if reading is safe.

    Reading could block if a material file named by the mesh exists but is not a regular file, for
    example a pipe.

    Args:
        file: Mesh file; only .obj files refer to material files.
    """
    if file.suffix.lower() != ".obj":
        return None
    with file.open("rb") as lines:
        words = (line.split() for line in lines if b"mtllib" in line)
        names = [
            name
            for first, *materials in words
            for name in materials
            if first == b"mtllib"
        ]
    for name in names:
        place = file.parent / os.fsdecode(name)
        if place.exists() and not place.is_file():
            return f"its material '{place.name}' is no regular file"
    return None


def _is_in_package(file: Path, model: Path) -> bool:
    """Test whether a file lies below the model's folder or in its package.

    The package is a folder above the file that contains package.xml. Otherwise it is the parent of
    the model's folder, provided that PACKAGE_FOLDERS contains the name of the model's folder or of
    the parent's subfolder that contains the file.

    Args:
        file: File, with symbolic links resolved.
        model: Model file, with symbolic links resolved.
    """
    home = model.parent
    if home in file.parents or any(
        (folder / "package.xml").is_file() for folder in file.parents
    ):
        return True
    if home.parent not in file.parents:
        return False
    return bool(
        PACKAGE_FOLDERS
        & {home.name.lower(), file.relative_to(home.parent).parts[0].lower()}
    )


def mjcf_references(path: Path) -> Iterator[tuple[Path, Path]]:
    """Yield existing files referenced by an MJCF and its includes, with their base folders.

    Every file is yielded once, with the folder to which its name in the MJCF is relative. Names are
    resolved against the folders of the model and of the including file, combined with every
    meshdir, texturedir and assetdir.

    Raises:
        ModelError: A name refers to a device or a pipe, which would block readers.
    """
    pending, visited, assets = [path], {path}, {""}
    while pending:
        current = pending.pop()
        root = read_xml(current)
        for compiler in root.iter("compiler"):
            assets |= {
                compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")
            }
        folders = {
            parent / name for parent in (path.parent, current.parent) for name in assets
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
                if file in visited or not file.is_file():
                    continue
                visited.add(file)
                yield file, folder.resolve()
                if file.suffix.lower() in (".xml", ".mjcf"):
                    pending.append(file)
