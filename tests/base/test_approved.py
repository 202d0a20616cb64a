"""What counts as the same text: a copy that forgives all would approve all."""

from __future__ import annotations

import pytest

from tests.helpers.approved import same

SAME = [
    ("mass 20.01(3) kg", "mass 20.02(3) kg"),  # the last digit
    ("rms 1.4143", "rms 1.4150"),  # libraries differ, signals have noise
    ("dust 3.1e-16", "dust -2e-15"),
    ("at 10480 N", "at 10481 N"),
]
OTHER = [
    ("mass 20.01(3) kg", "mass 20.11(3) kg"),
    ("mass 20.01 kg", "mass 20.01 N"),
    ("6 runs", "7 runs"),
    ("waist 3.0", "elbow 3.0"),
    ("sigma 1e-4", "sigma 2e-4"),
    ("at 10480 N", "at 10580 N"),
    ("a line", None),
    ("mass       20", "mass 20"),
]


@pytest.mark.parametrize(("was", "now"), SAME)
def test_numbers_may_differ_by_what_machines_do(was: str, now: str) -> None:
    assert same(was, now)


def test_columns_stay_in_line() -> None:
    assert same("waist    0.00051   3%", "waist     0.0005   3%", 0.1)
    assert not same("waist    0.00051   3%", "waist    0.0006   3%", 0.1)


@pytest.mark.parametrize(("was", "now"), OTHER)
def test_all_else_is_a_change(was: str, now: str | None) -> None:
    assert not same(was, now)
