"""Consistent bodies as JSON takes them, and where a written file's numbers come from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from testbed.experiment.versions import versions
from testbed.files import fingerprint
from testbed.identification.consistency import Consistent
from testbed.parameters.barycentric import STANDARD
from testbed.robot.model_file import ModelFile

DIGITS = 16
"""Of a fingerprint, in a comment."""


def consistent_as_json(found: Consistent) -> dict[str, Any]:
    """Consistent bodies as JSON takes them.

    Args:
        found: The bodies, friction and rotors.
    """
    return {
        "parameters": list(STANDARD),
        "links": {
            link: {
                "joint": joint,
                "values": found.standard[k].tolist(),
                "sigma": found.sigma[k].tolist(),
                "told": found.told[k].tolist(),
                "prior": found.prior[k].tolist(),
                "eigenvalues": found.eigenvalues[k].tolist(),
                "margin": float(found.margin[k]),
            }
            for k, (link, joint) in enumerate(zip(found.links, found.joints, strict=True))
        },
        "terms": {
            f"{term.law.kind}/{found.places[term.joint]}": {
                "value": float(value),
                "sigma": float(sigma),
            }
            for term, value, sigma in zip(
                found.terms, found.coefficients, found.coefficient_sigma, strict=True
            )
        },
        "bent": {
            each.method: {
                "names": list(each.names),
                "values": each.values.tolist(),
                "sigma": each.sigma.tolist(),
                "sigmas": each.sigmas.tolist(),
                "distance": each.distance,
            }
            for each in found.bent
        },
        "binding": list(found.binding),
        "prior_error": found.prior_error,
        "tried": {f"{error:g}": left for error, left in found.tried.items()},
        "diagnostics": [each.as_dict() for each in found.diagnostics],
    }


def provenance(found: Consistent, model: ModelFile, recordings: Sequence[Path]) -> list[str]:
    """Where the numbers of a written file come from, for a comment.

    Args:
        found: What is written.
        model: The file that is copied.
        recordings: What it was identified from.
    """
    methods = " and ".join(each.method for each in found.bent)
    return [
        f"testbed {versions()['testbed']}: inertials and joint losses are physically consistent",
        f"ones by the {methods} method from",
        *(f"{each.name} (sha256 {fingerprint(each)[:DIGITS]})," for each in recordings),
        f"prior {model.path.name} (sha256",
        f"{fingerprint(model.path)[:DIGITS]}) taken to be wrong by {found.prior_error:g}; all else",
        "is that file, unchanged",
    ]
