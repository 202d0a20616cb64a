"""Where the mesh files of a URDF are."""

from __future__ import annotations

from pathlib import Path


def find_mesh(name: str, model: Path) -> tuple[Path, Path] | None:
    """A mesh's file, and the folder from which its name leads there; None if there is none.

    package://PACKAGE/... is looked for below all folders above the model, with and without
    the package's name.

    Args:
        name: As in the model file.
        model: The model file.
    """
    places = [model.resolve().parent, *model.resolve().parent.parents]
    bare = Path(name.removeprefix("file://"))
    tried = [(places[0], bare)]
    if name.startswith("package://"):
        rest = Path(name.removeprefix("package://"))
        inside = Path(*rest.parts[1:]) if len(rest.parts) > 1 else rest
        tried = [(place, part) for place in places for part in (rest, inside)]
    for place, part in tried:
        if (place / part).is_file():
            return place, place / part
    return None
