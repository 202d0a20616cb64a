"""Metadata of a recording, typed and checked once, where its file is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal

from testbed.core.base.arrays import Array
from testbed.core.base.codec import decode, encode
from testbed.core.base.diagnostics import Diagnostic

Three = tuple[float, float, float]
Table = Mapping[str, Any]

IN_FILES = {"report": "import"}
"""Names in files that are no names in Python."""


def three(vector: Array) -> Three:
    """Vector, (3,), as plain numbers."""
    x, y, z = vector.tolist()
    return x, y, z


@dataclass(frozen=True)
class JointGeometry:
    """Geometry of a joint as far as it is known; None for what is not.

    Attributes:
        kind: Of its motion.
        parent: Joint that carries it, "bedplate" for none.
        axis: In the frame of its body.
        offset: p_PB_P of its frame B in the parent's P [m].
        rotation: R_PB at position zero, row by row.
    """

    kind: Literal["revolute", "prismatic"] | None = None
    parent: str | None = None
    axis: Three | None = None
    offset: Three | None = None
    rotation: tuple[Three, Three, Three] | None = None


@dataclass(frozen=True)
class Metadata:
    """Metadata of a recording; empty, or None, where they are not known.

    Attributes:
        robot: Name of the robot.
        gravity: (gx, gy, gz) [m/s^2], bedplate frame.
        geometry: Of the joints, by name.
        counted: Times of the samples that count [s].
        gaps: Times of the first samples after gaps [s].
        sensors: Places of force sensors in the robot, by name.
        segment: Force sensor whose wrench it is, and those beyond which nothing is in it.
        effort: By joint, what its torque was made of: "current", "pwm", "motor" or "torque".
        mapping: Content of the mapping file that made it; None for a recording of our own.
        report: Of the import.
        verdict: Of the check, and the hash of what it holds for.
        diagnostics: Of the recording itself.
        model_sha256: Hash of the model file that was simulated.
        others: Further metadata by name, kept as they are.
    """

    __pydantic_config__: ClassVar[Any] = {"allow_inf_nan": False}
    robot: str = ""
    gravity: Three | None = None
    geometry: Mapping[str, JointGeometry] = field(default_factory=dict)
    counted: tuple[float, float] | None = None
    gaps: tuple[float, ...] = ()
    sensors: Mapping[str, Table] = field(default_factory=dict)
    segment: tuple[str, ...] = ()
    effort: Mapping[str, str] = field(default_factory=dict)
    mapping: Table | None = None
    report: Table = field(default_factory=dict)
    verdict: Table = field(default_factory=dict)
    diagnostics: tuple[Diagnostic, ...] = ()
    model_sha256: str = ""
    others: Table = field(default_factory=dict)

    @staticmethod
    def parse(content: Table) -> Metadata:
        """Metadata of a file's table.

        Args:
            content: Plain values, as JSON gives them.

        Raises:
            ValueError: A value is not of its type; names it.
        """
        names = {
            IN_FILES.get(each.name, each.name): each.name for each in fields(Metadata)
        }
        known = {
            names[k]: v for k, v in content.items() if k in names and v is not None
        }
        others = {k: v for k, v in content.items() if k not in names}
        try:
            metadata: Metadata = decode(Metadata, known | {"others": others}, {})
        except ValueError as error:
            first = error.errors()[0]  # type: ignore[attr-defined]
            place = ".".join(f"'{each}'" for each in first["loc"])
            raise ValueError(f"its {place}: {first['msg']}") from None
        return metadata

    def table(self) -> dict[str, Any]:
        """Metadata that are known, as JSON takes them."""
        content: dict[str, Any] = encode(self)
        known = {
            k: v
            for k, v in content.items()
            if getattr(self, k) != getattr(NO_METADATA, k)
        }
        others: dict[str, Any] = known.pop("others", {})
        return {IN_FILES.get(k, k): v for k, v in known.items()} | others


NO_METADATA = Metadata()
"""Of a recording of which nothing is known."""
