"""Typed metadata of a recording, checked when its file is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal

from testbed.core.base.arrays import Array
from testbed.core.base.codec import from_json_values, to_json_values
from testbed.core.base.diagnostics import Diagnostic

Vector3 = tuple[float, float, float]
Table = Mapping[str, Any]

FILE_KEYS = {"report": "import"}
"""Keys in files that are reserved words of Python, keyed by field name."""


def vector_tuple(vector: Array) -> Vector3:
    """Vector of three components, (3,), as a tuple of floats."""
    x, y, z = vector.tolist()
    return x, y, z


@dataclass(frozen=True)
class JointGeometry:
    """Geometry of a joint; unknown values are None.

    Attributes:
        kind: Type of the joint.
        parent: Name of the parent joint, or "bedplate" if there is no parent joint.
        axis: Joint axis in the frame B of the joint's body.
        offset: Position p_PB_P of frame B in the parent's frame P [m].
        rotation: Rotation matrix R_PB at position zero, row by row.
    """

    kind: Literal["revolute", "prismatic"] | None = None
    parent: str | None = None
    axis: Vector3 | None = None
    offset: Vector3 | None = None
    rotation: tuple[Vector3, Vector3, Vector3] | None = None


@dataclass(frozen=True)
class Metadata:
    """Metadata of a recording; unknown values are empty or None.

    Attributes:
        robot: Name of the robot.
        gravity: Gravity (gx, gy, gz) in the bedplate frame [m/s^2].
        geometry: Geometry of the joints, keyed by joint name.
        counted: Time of the first evaluated sample, and time after the last one [s].
        gaps: Times of the first samples after gaps [s].
        sensors: Positions of the force sensors in the robot, keyed by sensor name.
        segment: Name of the force sensor that measured the wrench, then names of the sensors whose
            wrenches were subtracted from it.
        effort: Source of the torque, keyed by joint: "current", "pwm", "motor" or "torque".
        mapping: Content of the mapping file of the import; None for other recordings.
        report: Report of the import.
        verdict: Verdict of the check, and hash of the checked data.
        diagnostics: Diagnostics of the recording.
        model_sha256: Hash of the model file that was simulated.
        others: Other metadata keyed by name, unchanged.
    """

    __pydantic_config__: ClassVar[Any] = {"allow_inf_nan": False}
    robot: str = ""
    gravity: Vector3 | None = None
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
        """Parse metadata from a table of a file.

        Args:
            content: Values as parsed from JSON; null means unknown, and unknown keys are stored in
                `others`.

        Raises:
            ValueError: A value has the wrong type; the message names its key.
        """
        names = {
            FILE_KEYS.get(item.name, item.name): item.name for item in fields(Metadata)
        }
        known = {
            names[k]: v for k, v in content.items() if k in names and v is not None
        }
        others = {k: v for k, v in content.items() if k not in names}
        try:
            metadata: Metadata = from_json_values(
                Metadata, known | {"others": others}, {}
            )
        except ValueError as error:
            first = error.errors()[0]  # type: ignore[attr-defined]
            place = ".".join(f"'{item}'" for item in first["loc"])
            raise ValueError(f"its {place}: {first['msg']}") from None
        return metadata

    def table(self) -> dict[str, Any]:
        """Known metadata as values that can be written as JSON, by key.

        Values equal to the default are left out. The items of `others` become keys of the table.
        """
        content: dict[str, Any] = to_json_values(self)
        known = {
            k: v
            for k, v in content.items()
            if getattr(self, k) != getattr(NO_METADATA, k)
        }
        others: dict[str, Any] = known.pop("others", {})
        return {FILE_KEYS.get(k, k): v for k, v in known.items()} | others


NO_METADATA = Metadata()
"""Metadata of a recording for which all values are unknown."""
