"""Recordings corrected by what another recording of the same instrument has shown."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.core.base.errors import UnknownName
from testbed.core.estimation.sensor.correction import NUISANCES, Corrected
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree


def lastingly_corrected(source: Source, tree: Tree, numbers: Mapping[str, float]) -> Source:
    """A recording with an instrument's numbers taken back that were found in another one.

    Those that are of one recording only, the plate's zero and drift, stay.

    Args:
        source: The recording, of the same instrument.
        tree: The robot.
        numbers: By name, such as "pose/rx"; others are as they should be.

    Raises:
        UnknownName: No instrument has such a number.
    """
    parts = {n: n.parts(tree) for n in NUISANCES}
    known = [part.name for own in parts.values() for part in own]
    for name in numbers:
        if name not in known:
            raise UnknownName("nuisance", name, known)
    lasting = {
        nuisance.kind: np.array([numbers.get(part.name, part.right) for part in own])
        for nuisance, own in parts.items()
        if not nuisance.passing and any(part.name in numbers for part in own)
    }
    return Corrected(source, lasting, tree) if lasting else source
