"""What an estimate cannot do is refused in words about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError, SettingsError, UnknownName
from testbed.identification.period import FEWEST, period_of
from testbed.identification.term_choice import choose_terms
from testbed.identification.wishes import Wishes
from testbed.parameters.prior import prior_of
from testbed.recordings.joined import joined
from tests.helpers.ideal import ideal
from tests.helpers.measured import measured
from tests.helpers.runs import noisy, robot

SETTINGS: dict[str, tuple[Callable[[], object], str]] = {
    "facts without coloured noise": (
        lambda: tb.Settings(noise="white", known={"mass": 3.0}),
        'known facts need noise = "ar"',
    ),
    "a negative time": (
        lambda: tb.Settings(reversal_reach=-1.0),
        r"reversal_reach is a time \[s\], found -1.0",
    ),
    "a word for a time": (
        lambda: tb.Settings(reversal_reach="soon"),  # type: ignore[arg-type]
        "reversal_reach is a time .* found 'soon'",
    ),
    "planes that are no table": (
        lambda: Wishes(symmetric=["xz"]),  # type: ignore[arg-type]
        r"symmetric is a table of planes by link, found \['xz'\]",
    ),
    "a number for yes": (
        lambda: Wishes(centres_in_shapes=1),  # type: ignore[arg-type]
        "centres_in_shapes is true or false: 1",
    ),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_that_make_no_sense_are_refused(name: str) -> None:
    made, said = SETTINGS[name]
    with pytest.raises(SettingsError, match=said):
        made()


def test_a_span_is_about_one_recording() -> None:
    tree = robot("gantry")
    both = joined([noisy(ideal(tree), seed) for seed in (1, 2)])
    with pytest.raises(SettingsError, match="span is about one recording; of several, cut each"):
        tb.identify(tree, both, settings=tb.Settings(span=(0.0, 1.0)))


def test_a_payload_is_weighed_under_one_gravity() -> None:
    tree = robot("gantry")
    estimate = tb.identify(tree, noisy(ideal(tree)))
    other = replace(estimate, gravity=np.array([0.0, 1.0, -9.76]))
    with pytest.raises(SettingsError, match="the two recordings are under different gravity"):
        tb.payload(tree, estimate, other)


def test_wishes_are_of_links_with_matter() -> None:
    tree = robot("ur5")
    estimate = tb.identify(tree, noisy(ideal(tree)))
    prior = prior_of(tree)
    light = replace(prior, standard=prior.standard * (np.arange(tree.n) != 2)[:, None])
    link = tree.joints[2].body
    said = rf"known.mass/{link} = 2 kg: it has no matter in the model file"
    with pytest.raises(SettingsError, match=said):
        tb.consistent(tree, [estimate], light, Wishes(known={f"mass/{link}": 2.0}, prior_error=0.3))
    with pytest.raises(UnknownName, match="symmetric link 'nowhere'"):
        tb.consistent(
            tree, [estimate], prior, Wishes(symmetric={"nowhere": ("xz",)}, prior_error=0.3)
        )
    with pytest.raises(SettingsError, match="need a prior error that is a number"):
        tb.consistent(tree, [estimate], prior, Wishes(prior_error="chosen"))


def test_terms_are_chosen_from_enough_rows() -> None:
    tree = robot("gantry")
    short = measured(tree, duration=0.8)
    with pytest.raises(RecordingError, match=r"gives \d+ rows, too few to foretell \d+ parts"):
        choose_terms(tree, short, tb.Settings())


def test_four_samples_may_repeat_and_three_may_not() -> None:
    """And one that rests never does."""
    turning = np.array([[1.0], [-1.0]] * 10)
    assert period_of(turning) == 2
    assert period_of(turning[: FEWEST - 1]) is None
    assert period_of(np.ones((20, 2))) is None
    assert period_of(np.arange(20.0)[:, None]) is None


def test_an_estimate_shows_itself_in_words() -> None:
    tree = robot("gantry")
    estimate = tb.identify(tree, noisy(ideal(tree)))
    assert repr(estimate) == str(estimate)
    assert f"{len(estimate.names)} parameters from the bedplate" in repr(estimate)
    found = tb.minimal_set(tree, "reaction")
    assert repr(found).startswith(f"<MinimalSet of the reaction model, {found.count}: ")
    assert ", ".join(found.names) in repr(found)
    with pytest.raises(UnknownName, match=r"model 'static'.*dynamic.*reaction"):
        tb.minimal_set(tree, "static")  # type: ignore[arg-type]


def test_trees_are_in_the_order_of_their_joints() -> None:
    tree = robot("gantry")
    with pytest.raises(ValueError, match=f"{tree.n} joints carry {tree.n - 1} inertias"):
        replace(tree, inertias=tree.inertias[:-1])
    turned = (replace(tree.joints[0], parent=0), *tree.joints[1:])
    with pytest.raises(ValueError, match=r"joint 'j1' \(0\) precedes its parent 0"):
        replace(tree, joints=turned)
