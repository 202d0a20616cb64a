"""What the name of a foreign column says: what is measured, in which unit, of which joint."""

from __future__ import annotations

import re
from dataclasses import dataclass

from testbed.recordings.importing.foreign_units import (
    FORCES,
    KINDS,
    MOMENTS,
    RAW,
    TIMES,
    UNITS,
    plain,
)

PARTS = {
    "velocity": ("vel", "speed", "qd", "dq"),
    "acceleration": ("acc", "qdd", "ddq"),
    "torque": ("torque", "tau", "effort", "cur", "current", "trq"),
    "wrench": ("force", "wrench", "moment"),
    "position": ("pos", "angle", "enc", "joint", "state"),
}
"""Beginnings or ends of words by which columns are told apart."""

SYMBOLS = {
    "q": "position", "theta": "position", "qpos": "position",
    "qd": "velocity", "dq": "velocity", "qvel": "velocity", "qdot": "velocity",
    "qdd": "acceleration", "ddq": "acceleration", "qacc": "acceleration",
    "i": "torque", "tau": "torque", "ft": "wrench", "w": "wrench",
    "quat": "base", "quaternion": "base", "orientation": "base", "pose": "base", "base": "base",
}  # fmt: skip
"""Words of names, whole, that say more than their parts."""

COMMANDS = {
    "target", "cmd", "cmds", "command", "commands", "commanded", "cmptd", "computed", "des",
    "desired", "ref", "reference", "goal", "setpoint", "sp", "action", "demand", "planned",
}  # fmt: skip
"""Words of what was wanted, and not measured."""

BESIDE = COMMANDS | {
    "err", "error", "temp", "temperature", "limit", "std", "cov", "covariance", "voltage", "status",
}  # fmt: skip
"""Words of columns that are no signal of the joints or of the plate, whatever else they say."""

MEASURED = {"actual", "act", "measured", "meas", "msr", "fbk", "feedback"}
"""Words of what was measured, where there is a command beside it."""

SAYING = {*SYMBOLS, *MEASURED, "motor", "log", "data"}
"""Words of signals, whole."""

JOINT_WORDS = {"joint", "j", "axis", "a", "link"}
"""Words of joints."""

WORD = r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+"
"""A word of a name, or a number."""

HAND = {"tcp", "ee", "eef", "tool", "wrist", "flange", "gripper", "hand"}
"""Words of a wrench that is not the plate's."""

TURNS = {"quat", "quaternion", "orientation", "rotation", "qw", "qx", "qy", "qz"}
"""Words of a base's quaternion."""

RATES = {"vel", "velocity", "angular", "linear", "lin", "ang", "twist", "acc", "acceleration"}
"""Words of a base's columns that are not its pose."""

AXES = {
    f"{letter}{axis}": (part, k)
    for part, letters in enumerate(("f", "mt"))
    for letter in letters
    for k, axis in enumerate("xyz")
}
"""Of a wrench: force or moment, and along which axis, by words as fx."""

UNIT_WORDS = {
    "deg", "degrees", "rad", "radians", "mrad", "rpm", "Nm", "Nmm", "lbf", "kgf", "mm", "ms", "us",
    "ns", "mA", "sec", "msec", "usec", "nsec",
}  # fmt: skip
"""Words of names that are a unit wherever they stand; others need brackets."""


@dataclass(frozen=True)
class ColumnName:
    """A name, taken apart.

    Attributes:
        name: As the file has it.
        bare: Without the unit.
        words: Of the bare name, in small letters: letters and numbers apart.
        unit: As it is written here; None if the name has none.
        kind: A signal, or None where the name says none.
        role: Of a wrench's column: 0 for force or 1 for moment, and the axis; None if not said.
    """

    name: str
    bare: str
    words: tuple[str, ...]
    unit: str | None
    kind: str | None
    role: tuple[int, int] | None

    @property
    def beside(self) -> bool:
        """Whether it is a command, or none of the signals that a recording takes."""
        return not BESIDE.isdisjoint(self.words)


def read_name(name: str, said: str | None = None) -> ColumnName:
    """Take a name apart.

    Args:
        name: Of a column.
        said: What the file says of its unit beside the name.
    """
    bare, unit = without_unit(name)
    if said and plain(said) in ALL:
        unit = plain(said)
    words = words_of(bare)
    role = _role(words)
    kind = _kind(words, unit, role)
    if kind in ("velocity", "acceleration") and unit in UNITS["position"]:
        unit = f"{unit}/s" + "^2" * (kind == "acceleration")
    return ColumnName(name, bare, words, unit, kind, role)


ALL = {unit for units in UNITS.values() for unit in units} | RAW.keys() | TIMES.keys()


def words_of(text: str) -> tuple[str, ...]:
    """Words in small letters and numbers: ActualPosJ1 is actual, pos, j, 1."""
    return tuple(word.lower() for word in re.findall(WORD, text))


def says_signal(word: str) -> bool:
    """Whether a word says what is measured, of whatever joint."""
    small = word.lower()
    if small in JOINT_WORDS:
        return False
    parts = tuple(part for each in PARTS.values() for part in each)
    return small in SAYING or small.startswith(parts) or small.endswith(parts)


def without_unit(name: str) -> tuple[str, str | None]:
    """A name without its unit, as Fx (lbf), q_deg_1, vel_rad_s; and the unit."""
    for found in re.finditer(r"\s*[(\[{<]([^()\[\]{}<>]+)[)\]}>]", name):
        for unit in (plain(found[1]), plain(found[1].replace("_", "/"))):
            if unit in ALL:
                return name[: found.start()] + name[found.end() :], unit
    words = list(re.finditer(r"(?<![A-Za-z])[A-Za-z]+\d?(?![A-Za-z])", name))
    for first, found in enumerate(words):
        if found[0] not in UNIT_WORDS or len(words) == 1:
            continue
        last, unit = found, plain(found[0])
        if first + 1 < len(words) and words[first + 1][0] in ("s", "s2"):
            last = words[first + 1]
            unit = plain(f"{found[0]}/{last[0]}")
        if unit in ALL:
            return name[: found.start()].rstrip("_- ") + name[last.end() :], unit
    return name, None


def _role(words: tuple[str, ...]) -> tuple[int, int] | None:
    """Force or moment, and its axis."""
    for word in words:
        if word in AXES:
            return AXES[word]
    axes = [word for word in words if word in ("x", "y", "z")]
    moment = any(word.startswith(("torque", "moment")) for word in words)
    if len(axes) != 1 or not (moment or any(word.startswith("force") for word in words)):
        return None
    return int(moment), "xyz".index(axes[0])


def _kind(words: tuple[str, ...], unit: str | None, role: tuple[int, int] | None) -> str | None:
    """The signal, by words; by the unit where they say another one, or nothing."""
    if role is not None:
        return "wrench"
    named = [SYMBOLS[word] for word in words if word in SYMBOLS]
    order = ("wrench", "torque", "acceleration", "velocity", "position")
    ends = [(word.startswith, word.endswith) for word in words]
    parts = [k for k in order if any(end(PARTS[k]) for both in ends for end in both)]
    found = "base" if "base" in named else next(iter([*named[-1:], *parts]), None)
    if unit is None or found in ("wrench", "base"):
        return found
    if unit in RAW:
        return "torque"
    fitting = [kind for kind in KINDS if unit in UNITS[kind]]
    if found in fitting or unit in FORCES:
        return found
    return next(iter(fitting), None if unit in MOMENTS else found)
