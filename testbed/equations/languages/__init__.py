"""Equations as text: the notation of [FRS96], LaTeX, Python and C.

In: expressions.
Out: text.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Literal

from testbed.core.base.errors import UnknownName
from testbed.equations.equations import Listing
from testbed.equations.languages.c import c
from testbed.equations.languages.latex import write_latex, write_paper_notation
from testbed.equations.languages.python import write_python

Language = Literal["paper", "latex", "python", "c"]

WRITERS: dict[Language, Callable[[Listing, str], str]] = {
    "paper": write_paper_notation,
    "latex": write_latex,
    "python": write_python,
    "c": c,
}


def write_equations(listing: Listing, language: Language, source: str = "") -> str:
    """Write equations in a notation or programming language.

    Args:
        listing: The equations.
        language: "paper", "latex", "python" or "c".
        source: Origin of the robot model, for the header; any text.

    Raises:
        UnknownName: The language does not exist.
    """
    if language not in WRITERS:
        raise UnknownName("language", language, WRITERS)
    return WRITERS[language](listing, source)


def as_document(listing: Listing, text: str) -> dict[str, Any]:
    """Equations as a JSON document: text, parameters and operation counts.

    The matrix of each kind of equations maps barycentric to minimal parameters; it is None in the
    full form.

    Args:
        listing: The equations.
        text: The written equations.
    """
    sets = [listing.minimal.get(each.kind.model) for each in listing.equations]
    return {
        "robot": listing.tree.name,
        "form": listing.form,
        "gravity": listing.gravity.tolist(),
        "constants": {
            factor.name: value for factor, value in listing.constants.items()
        },
        "equations": {
            each.kind.name: {
                "shape": each.shape,
                each.parameter_vector_name: [
                    {"name": p.name, "unit": p.unit} for p in each.parameters
                ],
                "matrix": None if minimal is None else minimal.matrix.tolist(),
                "operations": asdict(each.program.count),
            }
            for each, minimal in zip(listing.equations, sets, strict=True)
        },
        "text": text,
    }
