"""Meshes, pictures and parts of models: which of them a copy of a model may bring along.

A model of a stranger may name any file of this machine, by its path or through a link. Only such
are copied that lie with the model and are by content what their ending says.
"""

from __future__ import annotations

import os
import re
import stat
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from testbed.errors import ModelError
from testbed.robot.parsing import read_xml

BEGINNING = 4096
"""Bytes by which a file's kind is recognised."""
PARTS = (".xml", ".mjcf", ".urdf")
"""Endings of models and of what they include."""
LAYOUT = {
    "urdf", "mjcf", "xml", "xacro", "sdf", "robot", "robots", "model", "models", "mesh", "meshes",
    "asset", "assets", "visual", "collision", "texture", "textures", "material", "materials",
    "stl", "obj", "dae",
}  # fmt: skip
"""Names of folders that stand beside each other in a robot's description."""
_OBJ = re.compile(rb"(#[^\n]*|(v[nt]?|f|o|g|s|l|mtllib|usemtl) [^\n]*|\s*)")


def _stl(head: bytes, size: int) -> bool:
    if len(head) >= 84 and size == 84 + 50 * struct.unpack_from("<I", head, 80)[0]:
        return True
    return head.lstrip()[:5].lower() == b"solid" and b"facet" in head.lower()


def _obj(head: bytes, size: int) -> bool:
    lines = [line.strip() for line in head.splitlines()][: -1 if size > len(head) else None]
    return any(line[:2] == b"v " for line in lines) and all(map(_OBJ.fullmatch, lines))


def _msh(head: bytes, size: int) -> bool:
    if len(head) < 16:
        return False
    corners, normals, places, faces = struct.unpack_from("<4i", head)
    numbers = 3 * (corners + normals + faces) + 2 * places
    return bool(corners > 0 and size == 16 + 4 * numbers)


def _heights(head: bytes, size: int) -> bool:
    if len(head) < 8:
        return False
    rows, columns = struct.unpack_from("<2i", head)
    return bool(rows > 0 and size == 8 + 4 * rows * columns)


def _begins(*marks: bytes) -> Callable[[bytes, int], bool]:
    return lambda head, size: head.startswith(marks)


_KINDS: dict[str, Callable[[bytes, int], bool]] = {
    ".stl": _stl,
    ".obj": _obj,
    ".msh": _msh,
    ".hf": _heights,
    ".dae": lambda head, size: b"<COLLADA" in head,
    ".ply": _begins(b"ply\n", b"ply\r"),
    ".off": _begins(b"OFF"),
    ".glb": _begins(b"glTF"),
    ".gltf": lambda head, size: head.lstrip()[:1] == b"{" and b'"asset"' in head,
    ".png": _begins(b"\x89PNG\r\n"),
    ".jpg": _begins(b"\xff\xd8\xff"),
    ".jpeg": _begins(b"\xff\xd8\xff"),
    ".bmp": _begins(b"BM"),
    **dict.fromkeys(PARTS, lambda head, size: head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"<"),
}
"""By ending: whether a file of such a beginning and size [bytes] is what its name says."""
ENDINGS = frozenset(_KINDS)


def asset_fault(file: Path, model: Path) -> str | None:
    """Why a file does not go into a copy of a model; None where it may.

    Args:
        file: As the model names it.
        model: The model file, links resolved.
    """
    ending, place = file.suffix.lower(), file.resolve()
    if ending not in ENDINGS:
        return f"'{ending}' is no ending of a mesh or picture"
    if not stat.S_ISREG(place.stat().st_mode):
        return "no regular file"
    with place.open("rb") as stream:
        head = stream.read(BEGINNING)
    if not _KINDS[ending](head, place.stat().st_size):
        return f"its content is no {ending[1:].upper()}"
    if (ending in PARTS and b"<mujoco" in head) or _beside(place, model):
        return None
    return "it lies outside of the model's package"


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
    if home in file.parents or any((each / "package.xml").is_file() for each in file.parents):
        return True
    if home.parent not in file.parents:
        return False
    return bool(LAYOUT & {home.name.lower(), file.relative_to(home.parent).parts[0].lower()})


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
            assets |= {compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")}
        folders = {place / name for place in (path.parent, here.parent) for name in assets}
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
                    raise ModelError(f"{path}: '{name}' is a device or pipe, no file of a model")
                if file in seen or not file.is_file():
                    continue
                seen.add(file)
                yield file, folder.resolve()
                if file.suffix.lower() in (".xml", ".mjcf"):
                    waiting.append(file)
