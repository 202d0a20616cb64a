"""Settings: checked where they are made, plain, and the same however they are written."""

from __future__ import annotations

import ast
import inspect
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import SettingsError, TestbedError, UnknownName
from testbed.identification import settings as module
from testbed.identification.settings import Settings
from testbed.robot.friction import LAWS, JointLaw
from tests.helpers.ideal import EXACT, ideal, true_values
from tests.helpers.paths import ROOT

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a cutoff of nothing": ({"cutoff": 0.0}, "cutoff is a positive frequency .* found 0"),
    "a negative cutoff": ({"position_cutoff": -1}, "position_cutoff is a positive frequency"),
    "an endless cutoff": ({"cutoff": np.inf}, "positive frequency"),
    "a cutoff that is no number": ({"cutoff": np.nan}, "positive frequency"),
    "a cutoff in words": ({"cutoff": "fast"}, "found 'fast'"),
    "a cutoff that is true": ({"cutoff": True}, "found True"),
    "a filter that biases": ({"position_cutoff": 6.0}, "less than twice cutoff = 5 Hz"),
    "a negative deadband": ({"deadband": -0.1}, "deadband is a speed"),
    "a deadband in words": ({"deadband": "slow"}, "deadband is a speed"),
    "no deadband": ({"deadband": None}, "deadband is a speed"),
    "a term that is not known": ({"terms": ("rotr",)}, "did you mean 'rotor'"),
    "a term twice": ({"terms": ("rotor", "rotor")}, "names something twice"),
    "a term for a list": ({"terms": "rotor"}, "terms is a list of names"),
    "a number for a term": ({"terms": (3,)}, "found 3 in it"),
    "unknown weights": ({"weights": "rows"}, "known: channels, full, a covariance"),
    "weights that are negative": ({"weights": [[-1.0]]}, "positive definite"),
    "weights askew": ({"weights": [[1.0, 0.5], [0.0, 1.0]]}, "not symmetric"),
    "weights not square": ({"weights": [[1.0, 0.5]]}, "not a square matrix"),
    "weights of words": ({"weights": [["a"]]}, "not a square matrix"),
    "weights without end": ({"weights": [[np.inf]]}, "not a square matrix"),
    "noise of another colour": ({"noise": "brown"}, "noise 'brown'.*known: ar, white"),
    "a tare that is guessed": ({"tare": "guessed"}, "tare 'guessed'.*known: "),
    "zeros in numbers": ({"zeros": 1}, "zeros is true, false or a list"),
    "zeros by number": ({"zeros": [1, 2]}, "zeros is true, false or a list"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused_in_a_line(case: str) -> None:
    given, said = REFUSED[case]
    with pytest.raises(TestbedError, match=said) as caught:
        Settings(**given)
    assert isinstance(caught.value, SettingsError | UnknownName)
    assert "\n" not in str(caught.value)


def test_off_is_off_however_it_is_said() -> None:
    none, off = (Settings(position_cutoff=v, cutoff=v) for v in (None, "off"))
    assert none == off
    assert (none.position_cutoff, none.cutoff) == ("off", "off")
    assert (none.position_low_pass, none.row_low_pass) == (None, None)
    numbers = Settings(position_cutoff=np.float64(40), cutoff=5)
    assert numbers == Settings().fitted(1000.0)
    assert (numbers.position_low_pass, numbers.row_low_pass) == (40.0, 5.0)


def test_filters_fit_the_sampling_rate() -> None:
    for rate, position, rows in ((1000.0, 40.0, 5.0), (60.0, None, 5.0), (30.0, None, 3.0)):
        fitted = Settings().fitted(rate)
        assert (fitted.position_low_pass, fitted.row_low_pass) == (position, rows)
    asked = Settings(position_cutoff=10.0, cutoff=2.0)
    assert asked.fitted(30.0) == asked


def test_settings_are_values() -> None:
    """Equal if they say the same, usable as keys, never changed; lists and arrays are taken."""
    covariance = np.diag([1.0, 2.0])
    one = Settings(zeros=["mb1x"], terms=["rotor"], weights=covariance.tolist())
    other = Settings(zeros=("mb1x",), terms=("rotor",), weights=covariance)  # type: ignore[arg-type]
    assert one == other
    assert hash(one) == hash(other)
    np.testing.assert_array_equal(one.covariance, covariance)
    assert one.joined
    assert not Settings().joined
    with pytest.raises(FrozenInstanceError):
        one.deadband = 1.0  # type: ignore[misc]
    assert replace(one, deadband=1) == replace(other, deadband=1.0)


def test_every_setting_says_what_it_is() -> None:
    """A line below each field, with its unit; no guest is needed to read them."""
    (found,) = (
        node
        for node in ast.parse(inspect.getsource(module)).body
        if isinstance(node, ast.ClassDef) and node.name == "Settings"
    )
    said = [
        first.target.id
        for first, second in zip(found.body, found.body[1:], strict=False)
        if isinstance(first, ast.AnnAssign)
        and isinstance(first.target, ast.Name)
        and isinstance(second, ast.Expr)
    ]
    assert said == [field.name for field in fields(Settings)]


def test_terms_are_laws() -> None:
    mine = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3)
    assert Settings(terms=("rotor", mine)).laws == (LAWS[3], mine)
    assert Settings().laws == LAWS[:2]


def test_zeros_are_a_setting_that_an_argument_overrides() -> None:
    """Three bodies on a line: some of their parameters are zero in the model file."""
    tree = tb.load_tree(ROOT / "models/puma562.xml")
    recording = ideal(tree)
    with_zeros = replace(EXACT, zeros=True)
    counts = {
        "none": len(tb.identify(tree, recording, settings=EXACT).names),
        "all": len(tb.identify(tree, recording, settings=with_zeros).names),
        "asked": len(tb.identify(tree, recording, settings=EXACT, zeros=True).names),
        "refused": len(tb.identify(tree, recording, settings=with_zeros, zeros=False).names),
        "some": len(tb.identify(tree, recording, zeros=["K3xy"], settings=EXACT).names),
    }
    assert counts["none"] == counts["refused"] > counts["some"] > counts["all"] == counts["asked"]
    found = tb.identify(tree, recording, settings=with_zeros)
    truth = true_values(tree, "external", zeros=True)
    np.testing.assert_allclose(found.values, truth, rtol=1e-9)
