"""The table of the public interface, from the one list of names: `python -m docs.interface`."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

from docs.marks import table, write

DOCUMENT = Path(__file__).with_name("python.md")
MODULE = "docs.interface"


def lines(of: str = "") -> str:
    """Rows of the table: a name and the first sentence on it; kinds of errors and effects."""
    import testbed as tb
    from testbed.lab.simulation.effect import Effect
    from testbed.sensors.kind_table import KindTable
    from testbed.sensors.sensor_error import SensorError

    del of
    titles = {SensorError: "errors of sensors", Effect: "effects in the plant"}
    rows, kinds = [], dict[type, list[str]]()
    for name in sorted(tb.__all__, key=str.lower):
        thing = getattr(tb, name)
        if inspect.isclass(thing) and issubclass(thing, KindTable):
            kinds.setdefault(SensorError if issubclass(thing, SensorError) else Effect, []).append(
                f"`{name}`"
            )
        elif not isinstance(thing, str):
            rows.append((f"`{name}`", first_sentence(thing)))
    rows += [
        (", ".join(names), f"{titles[base]} (`testbed list`)") for base, names in kinds.items()
    ]
    return "\n".join(["", *table("name | meaning", rows), "", ""])


def first_sentence(thing: object) -> str:
    """The first sentence of a docstring."""
    text = " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())
    return re.split(r"(?<=[.:;]) ", text)[0].rstrip(".:;")


if __name__ == "__main__":
    write(DOCUMENT, MODULE, lines)
