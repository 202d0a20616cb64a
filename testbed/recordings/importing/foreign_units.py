"""Units that instruments write, and what they are in SI."""

from __future__ import annotations

import math
import re
from typing import Literal

from testbed.errors import UnknownName

Kind = Literal["position", "velocity", "acceleration", "torque"]
KINDS: tuple[Kind, ...] = ("position", "velocity", "acceleration", "torque")
"""What is measured joint by joint."""

ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turn": 2 * math.pi}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}
FORCES = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}
MOMENTS = {
    "N m": 1.0, "N mm": 1e-3, "N cm": 1e-2, "kN m": 1e3, "lbf in": 0.1129848290276167,
    "lbf ft": 1.3558179483314004, "kgf m": 9.80665, "kgf cm": 0.0980665,
}  # fmt: skip
RAW = {"A": 1.0, "mA": 1e-3, "V": 1.0, "mV": 1e-3, "raw": 1.0}
"""Of what becomes a torque by a gain."""
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}

TURNING = {
    "position": ANGLES,
    "velocity": {f"{u}/s": f for u, f in ANGLES.items()} | {"rpm": math.pi / 30},
    "acceleration": {f"{u}/s^2": f for u, f in ANGLES.items()},
    "torque": MOMENTS,
}
SLIDING = {
    "position": LENGTHS,
    "velocity": {f"{u}/s": f for u, f in LENGTHS.items()},
    "acceleration": {f"{u}/s^2": f for u, f in LENGTHS.items()},
    "torque": FORCES,
}

UNITS = {kind: TURNING[kind] | SLIDING[kind] for kind in KINDS} | {
    "force": FORCES,
    "moment": MOMENTS,
}
"""By what is measured: what one of each is in SI."""

KNOWN = {name for units in UNITS.values() for name in units} | RAW.keys() | TIMES.keys()

WORDS = {
    "Nm": "N m", "Nmm": "N mm", "Ncm": "N cm", "kNm": "kN m", "degree": "deg", "degrees": "deg",
    "Grad": "deg",
    "radian": "rad", "radians": "rad", "rev": "turn", "revs": "turn", "turns": "turn",
    "lb": "lbf", "lbs": "lbf", "kp": "kgf", "inch": "in", "inches": "in", "foot": "ft",
    "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us", "nsec": "ns",
    "s2": "s^2", "s²": "s^2", "amp": "A", "amps": "A", "newton": "N",
}  # fmt: skip
"""Other ways to write words of units."""

WHOLE = {"in": "inch", "turn/min": "rpm", "dps": "deg/s", "rps": "turn/s", "inlbf": "lbf in"}
"""Other ways to write whole units."""


def plain(unit: str) -> str:
    """A unit as it is written here: in-lbf, N·m, °/s and the like are known.

    Args:
        unit: As a person or a file writes it.
    """
    short = " ".join(unit.split())
    if short in KNOWN:
        return short
    text = short.replace("°", "deg").replace("µ", "u").replace("μ", "u")
    text = re.sub(r"\s+s\^?-([12])$", r"/s^\1", text).replace("s^1", "s")
    parts = [_product(part) for part in re.split(r"\s*/\s*|\s+per\s+", text)]
    found = "/".join(parts)
    found = WHOLE.get(found, found)
    return found if found in KNOWN else short


def _product(text: str) -> str:
    """Factors of a unit, a force before its arm."""
    given = re.split(r"[\s*·⋅.\-_]+", text)
    plainer = [word.lower() if len(word) > 2 and word not in WORDS else word for word in given]
    words = [WORDS.get(word, word) for word in plainer]
    return " ".join(sorted(words, key=lambda word: word not in FORCES))


def check_unit(kind: str, unit: str, *, gained: bool = False) -> None:
    """Whether a unit is one of what is measured.

    Args:
        kind: What is measured, a key of `UNITS`.
        unit: As a person writes it.
        gained: Whether a gain makes a torque of it.

    Raises:
        ValueError: It is not.
    """
    if gained and kind != "torque":
        raise ValueError(f"{kind}.gain: gains are for torques")
    known = RAW if gained else UNITS[kind]
    if plain(unit) in known:
        return
    if plain(unit) in RAW and kind == "torque":
        raise ValueError(
            f"torque.unit: '{unit}' is no torque; say `gain`, how much one makes [N m]"
        )
    said = UnknownName(f"unit of {kind}{' with a gain' if gained else ''}", unit, known)
    raise ValueError(str(said))


def factor(kind: str, unit: str) -> float:
    """What one of a unit is in SI; one of a raw unit is itself.

    Args:
        kind: What is measured, a key of `UNITS`.
        unit: One that `check_unit` takes.
    """
    name = plain(unit)
    return UNITS[kind][name] if name in UNITS[kind] else RAW[name]


def slides(unit: str) -> bool:
    """Whether a position in this unit is of a joint that slides."""
    return plain(unit) in LENGTHS
