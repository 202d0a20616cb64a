"""Settings are refused where they make no sense; estimates are printed, and are data frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import RecordingError, SettingsError, TestbedError, UnknownName
from testbed.core.base.frames import frame_of
from testbed.core.base.summary_table import number_with_sigma
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.selection.term_choice import choose_terms
from testbed.core.estimation.settings import Settings
from testbed.core.robot.friction import JointLaw
from tests.helpers.ideal import EXACT, ideal, true_values
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import noisy, robot
from tests.helpers.strategies import wrong_numbers
from tests.scenarios.scenarios import result

NUMBERS = ("position_cutoff", "cutoff", "deadband", "reversal_reach")
NAMED = ("tare", "drives", "engine")
TWIN = JointLaw("viscous", "N m s/rad", "N s/m", lambda qd, qdd: qd)
MEANINGLESS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"cutoff": 0.0}, "cutoff"),
    ({"position_cutoff": 6.0, "cutoff": 5.0}, "twice cutoff = 5 Hz"),  # it would bias the estimate
    ({"terms": ("rotr",)}, "'rotor'"),
    ({"terms": ("rotor", "rotor")}, "terms"),
    ({"terms": ("viscous", TWIN)}, "terms"),
    ({"terms": "rotor"}, "terms"),
    ({"terms": (3,)}, "3"),
    ({"zeros": 1}, "zeros"),
    ({"zeros": [1, 2]}, "zeros"),
    ({"nuisances": ("skw",)}, "'skew'"),
    ({"nuisances": ("skew", "skew")}, "nuisances"),
    ({"nuisances": ("skew",), "cutoff": "off"}, "nuisances"),
    *(({"known": {"mass": given}}, "known") for given in ("20", (1, -1), (1, 2, 3))),
    *(({"span": s}, "span") for s in ([1.0], [2.0, 1.0], [1.0, 1.0], "ab", ["a", 2], [0, np.inf])),
)


@given(wrong_numbers)
def test_what_is_no_number_is_refused_by_the_settings_name(wrong: Any) -> None:
    for name in NUMBERS:
        if wrong is not None or name == "deadband":  # elsewhere: the default
            with refuses(SettingsError, name):
                Settings(**{name: wrong})


def test_what_makes_no_sense_is_refused_by_the_settings_name() -> None:
    for given_settings, culprit in MEANINGLESS:
        with refuses((SettingsError, UnknownName), culprit):  # type: ignore[arg-type]
            Settings(**given_settings)
    for name in NAMED:
        with refuses(SettingsError, name, "'nonsense'"):
            Settings(**{name: "nonsense"})  # type: ignore[arg-type]


def test_filters_fit_the_sampling_rate_unless_they_are_said() -> None:
    for rate, position, rows in ((1000.0, 40.0, 5.0), (60.0, None, 5.0), (30.0, None, 3.0)):
        fitted = Settings().fitted(rate)
        assert (fitted.position_low_pass, fitted.row_low_pass) == (position, rows)
    asked = Settings(position_cutoff=10.0, cutoff=2.0)
    assert asked.fitted(30.0) == asked
    none, off = (Settings(position_cutoff=v, cutoff=v) for v in (None, "off"))
    assert none == off == off.fitted(30.0)
    assert (off.position_low_pass, off.row_low_pass) == (None, None)
    assert Settings(position_cutoff=np.float64(40), cutoff=5) == Settings().fitted(1000.0)


def test_settings_are_values() -> None:
    """Equal if they say the same, usable as keys, never changed."""
    one, other = (
        Settings(zeros=["mb1x"], terms=["rotor"]),
        Settings(zeros=("mb1x",), terms=("rotor",)),
    )
    assert (one, hash(one)) == (other, hash(other))
    assert replace(one, deadband=1) == replace(other, deadband=1.0)
    with pytest.raises(FrozenInstanceError):
        one.deadband = 1.0  # type: ignore[misc]


def test_known_zeros_are_left_out_and_an_argument_overrides_the_setting(puma: tb.Tree) -> None:
    """Three bodies on a line: some of their parameters are zero in the model file."""
    recording, with_zeros = ideal(puma), replace(EXACT, zeros=True)
    truth = true_values(puma, "external", zeros=True)
    for settings, zeros, count in (
        (EXACT, None, 20),
        (with_zeros, None, len(truth)),
        (EXACT, True, len(truth)),
        (with_zeros, False, 20),
        (EXACT, ["K3xy"], 19),
    ):
        found = tb.identify(puma, recording, settings=settings, zeros=zeros)
        assert len(found.names) == count
        if count == len(truth):
            np.testing.assert_allclose(found.values, truth, rtol=1e-9)


def test_what_does_not_fit_the_robot_or_the_recording_is_refused_by_name() -> None:
    tree = robot("ur5")
    recording = noisy(ideal(tree))
    nothing = tb.Inertia.about_centre(0.0, np.zeros(3), np.zeros((3, 3)))
    light, zeros = replace(tree, inertias=(nothing,) * tree.n), replace(EXACT, zeros=True)
    estimate = tb.identify(tree, recording)
    elsewhere, short = replace(estimate, gravity=np.ones(3)), measured(tree, duration=0.8)
    cases: tuple[tuple[type[Exception], str, Callable[[], object]], ...] = (
        (SettingsError, "gravity", lambda: tb.payload(tree, estimate, elsewhere)),
        (SettingsError, "zeros", lambda: tb.identify(light, recording, settings=zeros)),
        (UnknownName, "plate", lambda: tb.identify(tree, recording, "plate")),  # type: ignore[arg-type]
        (UnknownName, "static", lambda: tb.minimal_set(tree, "static")),  # type: ignore[arg-type]
        (RecordingError, "rows", lambda: choose_terms(Problem.of(tree, short, "internal"))),
    )
    for kind, culprit, asked in cases:
        with refuses(kind, culprit):
            asked()


def test_every_form_holds_every_parameter() -> None:
    """Warnings too, and safely; data frames by whichever package is there."""
    found = replace(
        result("gantry").estimates["internal"],
        diagnostics=(Diagnostic("note", "<b>mind</b> this"),),
    )
    lines = str(found).splitlines()
    for name, value, sigma, unit, line in zip(
        found.names, found.values, found.sigma, found.units, lines[1:-1], strict=True
    ):
        words = (name, number_with_sigma(float(value), float(sigma)), unit)
        assert [part for part in words if part not in line] == []
    assert "<b>mind</b> this" in lines[-1]
    page = found._repr_html_()
    assert page.count("<tr>") == len(found.names)
    assert "&lt;b&gt;mind" in page
    np.testing.assert_array_equal(np.asarray(found.to_frame()["sigma"]), found.sigma)
    with refuses(TestbedError, "sparrow"):
        frame_of({"sigma": found.sigma}, "sparrow")


def test_a_number_has_the_digits_that_its_sigma_has_to_say() -> None:
    for value, sigma, wanted, short in (
        (1.06104, 0.00094, "1.06104 +- 0.00094", "1.06104(94)"),
        (-123.456, 12.0, "-123.5 +- 12.0", "-123.5(12.0)"),
        (5.0, 1.0, "5.0 +- 1.0", "5.0(1.0)"),
        (1.0, 1e-12, "1 +- 1e-12", "1 +- 1e-12"),
        (2.5, 0.0, "2.5", "2.5"),
        (1e-17, 1e-18, "0", "0"),
    ):
        assert (number_with_sigma(value, sigma), number_with_sigma(value, sigma, True)) == (
            wanted,
            short,
        )
    assert not any(digit in number_with_sigma(3.0, np.inf) for digit in "0123456789")
