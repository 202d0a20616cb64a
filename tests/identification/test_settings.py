"""Settings and wishes: what makes no sense is refused where it is said, before hours of work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.errors import RecordingError, SettingsError, UnknownName
from testbed.identification.settings import Settings
from testbed.identification.term_choice import choose_terms
from testbed.identification.wishes import Wishes
from testbed.parameters.prior import prior_of
from testbed.robot.friction import LAWS, JointLaw
from tests.helpers.ideal import EXACT, ideal, true_values
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import noisy, robot
from tests.helpers.strategies import wrong_numbers

NUMBERS = ("position_cutoff", "cutoff", "deadband", "reversal_reach")
NAMED = ("noise", "weights", "tare", "drives", "engine")
TWIN = JointLaw("viscous", "N m s/rad", "N s/m", lambda qd, qdd: qd)
MEANINGLESS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"cutoff": 0.0}, "cutoff"),
    ({"position_cutoff": 6.0}, "twice cutoff = 5 Hz"),  # it would bias the estimate
    ({"terms": ("rotr",)}, "'rotor'"),
    ({"terms": ("rotor", "rotor")}, "terms"),
    ({"terms": ("viscous", TWIN)}, "terms"),
    ({"terms": "rotor"}, "terms"),
    ({"terms": (3,)}, "3"),
    *(({"weights": given}, "weights") for given in ([[-1.0]], [[1, 0.5], [0, 1]], [[1.0, 0.5]])),
    *(({"weights": given}, "weights") for given in ([["a"]], [[np.inf]], [[0.0]])),
    ({"zeros": 1}, "zeros"),
    ({"zeros": [1, 2]}, "zeros"),
    ({"ridge": 1}, "ridge"),
    ({"nuisances": ("skw",)}, "'skew'"),
    ({"nuisances": ("skew", "skew")}, "nuisances"),
    ({"nuisances": ("skew",), "noise": "white"}, "nuisances"),
    ({"nuisances": ("skew",), "cutoff": "off"}, "nuisances"),
    ({"noise": "white", "known": {"mass": 3.0}}, "known"),
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
        with refuses(UnknownName, name, "'nonsense'"):
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
    covariance = np.diag([1.0, 2.0])
    one = Settings(zeros=["mb1x"], terms=["rotor"], weights=covariance.tolist())
    other = Settings(zeros=("mb1x",), terms=("rotor",), weights=covariance)  # type: ignore[arg-type]
    assert one == other
    assert hash(one) == hash(other)
    np.testing.assert_array_equal(one.covariance, covariance)
    assert (one.joined, Settings().joined) == (True, False)
    assert (one.laws, Settings().laws) == ((LAWS[3],), LAWS[:2])
    with pytest.raises(FrozenInstanceError):
        one.deadband = 1.0  # type: ignore[misc]
    assert replace(one, deadband=1) == replace(other, deadband=1.0)


def test_known_zeros_are_left_out_and_an_argument_overrides_the_setting(puma: tb.Tree) -> None:
    """Three bodies on a line: some of their parameters are zero in the model file."""
    recording, with_zeros = ideal(puma), replace(EXACT, zeros=True)
    none, every, asked, refused, some = (
        len(tb.identify(puma, recording, settings=settings, zeros=zeros).names)
        for settings, zeros in (
            (EXACT, None),
            (with_zeros, None),
            (EXACT, True),
            (with_zeros, False),
            (EXACT, ["K3xy"]),
        )
    )
    assert none == refused > some > every == asked
    found = tb.identify(puma, recording, settings=with_zeros)
    np.testing.assert_allclose(found.values, true_values(puma, "external", zeros=True), rtol=1e-9)
    light = replace(
        puma, inertias=(tb.Inertia.about_centre(0.0, np.zeros(3), np.zeros((3, 3))),) * 3
    )
    for method in ("external", "internal"):
        with refuses(SettingsError, "zeros"):  # nothing is left
            tb.identify(light, recording, method, settings=with_zeros)


def test_what_does_not_fit_the_robot_or_the_recording_is_refused_by_name() -> None:
    tree = robot("ur5")
    recording = noisy(ideal(tree))
    estimate, prior, link = tb.identify(tree, recording), prior_of(tree), tree.joints[2].body
    light = replace(prior, standard=prior.standard * (np.arange(tree.n) != 2)[:, None])
    elsewhere = replace(estimate, gravity=np.array([0.0, 1.0, -9.76]))
    wished = Wishes(known={f"mass/{link}": 2.0}, prior_error=0.3)
    nowhere = Wishes(symmetric={"nowhere": ("xz",)}, prior_error=0.3)
    five = replace(EXACT, weights=np.eye(5).tolist())
    chosen, gantry = Wishes(prior_error="chosen"), robot("gantry")
    short = measured(gantry, duration=0.8)
    cases: tuple[tuple[type[Exception], str, Callable[[], object]], ...] = (
        (SettingsError, "symmetric", lambda: Wishes(symmetric=["xz"])),  # type: ignore[arg-type]
        (SettingsError, "centres_in_shapes", lambda: Wishes(centres_in_shapes=1)),  # type: ignore[arg-type]
        (SettingsError, f"mass/{link}", lambda: tb.consistent(tree, [estimate], light, wished)),
        (UnknownName, "nowhere", lambda: tb.consistent(tree, [estimate], prior, nowhere)),
        (SettingsError, "prior", lambda: tb.consistent(tree, [estimate], prior, chosen)),
        (SettingsError, "gravity", lambda: tb.payload(tree, estimate, elsewhere)),
        (SettingsError, "5 channels", lambda: tb.identify(tree, recording, settings=five)),
        (UnknownName, "plate", lambda: tb.identify(tree, recording, "plate")),  # type: ignore[arg-type]
        (UnknownName, "static", lambda: tb.minimal_set(tree, "static")),  # type: ignore[arg-type]
        (RecordingError, "rows", lambda: choose_terms(gantry, short, Settings())),
    )
    for kind, culprit, asked in cases:
        with refuses(kind, culprit):
            asked()
