"""Findings as a person reads them: one cause first, with what follows from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.identification.cross_check import findings_of
from testbed.identification.estimate import METHODS
from testbed.identification.finding import SYMPTOMS, Finding, folded
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN, ROOT

CONSTANT = Finding(
    "torque a", "is off", 1.05, ("a constant",), "mend it", "torque-constant", "internal", 90.0
)
CLOCK = Finding("the plate", "is late", 2.0, ("a clock",), "set it", "fault-skew", "external", 30.0)
ENCODER = Finding("encoder", "is in degrees", 1.0, ("a unit",), "convert it", "encoder-range")


def symptom(code: str, method: str) -> Finding:
    return Finding(f"{method} {code}", "is odd", 1.0, ("anything",), "look", code, method)


BODIES = [symptom("no-rigid-bodies", method) for method in METHODS]
RESIDUAL = symptom("residual", "external")


def test_a_symptom_is_told_beside_its_cause_and_not_before() -> None:
    (line,) = folded([BODIES[1], CONSTANT, symptom("systematic-error", "internal")])
    assert line.startswith("torque a is off; likely a constant; mend it")
    for code in ("no-rigid-bodies", "systematic-error"):
        assert SYMPTOMS[code] in line
    assert "anything" not in line


def test_causes_stand_in_the_order_of_their_support() -> None:
    lines = folded([CLOCK, CONSTANT, ENCODER, *BODIES])
    assert [line.split(" is ")[0] for line in lines] == ["encoder", "torque a", "the plate"]
    assert SYMPTOMS["no-rigid-bodies"] in lines[0]
    assert not any("this explains" in line for line in lines[1:])


def test_a_cause_of_one_method_explains_nothing_of_the_other() -> None:
    lines = folded([CONSTANT, BODIES[0]])
    assert len(lines) == 2
    assert "this explains" not in lines[0]


def test_a_small_fault_explains_no_gross_residual() -> None:
    assert len(folded([CLOCK, RESIDUAL])) == 2
    assert folded([CLOCK, RESIDUAL])[0].startswith("external residual")
    assert len(folded([ENCODER, RESIDUAL])) == 1


def test_symptoms_without_a_cause_are_under_the_first_of_themselves() -> None:
    lines = folded([symptom("systematic-error", "internal"), BODIES[1]])
    assert len(lines) == 1
    assert lines[0].startswith("internal no-rigid-bodies")
    assert folded([]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5", "kuka_lwr4"])
def test_the_first_line_is_of_what_was_done_to_the_recording(name: str) -> None:
    """Torque constants off by 5 %, or a plate that is 5 ms late."""
    paths = {"puma": ROOT / "models/puma562.xml"}
    tree = tb.load_tree(paths.get(name, GOLDEN / f"robots/{name}.urdf"))
    clean = measured(tree, duration=40.0)
    gain = np.where(np.arange(tree.n) % 2, 0.95, 1.05)
    weak = replace(clean, torque=clean.measured("torque") * gain)
    late = replace(clean.part(1, clean.samples), wrench=clean.measured("wrench")[:-1])
    for recording, code in ((weak, "torque-constant"), (late, "fault-")):
        estimates = [tb.identify(tree, recording, method) for method in METHODS]
        found = findings_of(estimates)
        causes = [each for each in found if each.code.startswith(code)]
        assert causes
        first = folded(found)[0]
        assert causes[0].causes[0] in first
        kinds = {each.code for each in found} & set(SYMPTOMS)
        assert all(SYMPTOMS[each] in first for each in kinds)
