"""Table of model-errors.md, from the families themselves: `python -m docs.model_errors`."""

from __future__ import annotations

from pathlib import Path

from docs.marks import table, write
from testbed.core.estimation.model_errors.catalogue import model_error_families

DOCUMENT = Path(__file__).parent / "model-errors.md"
MODULE = "docs.model_errors"
BY = {"torque": "torques", "wrench": "plate"}


def as_markdown(of: str) -> str:
    """All families.

    Args:
        of: Nothing else is written.
    """
    del of
    rows = [
        (
            f"`{each.kind}`",
            ", ".join(BY[method] for method in each.methods),
            each.label,
            each.meaning if each.meaning != each.label else "",
            each.remedy,
        )
        for each in model_error_families()
    ]
    return "\n".join(["", *table("family | by | what it is | cause | remedy", rows), "", ""])


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown)
