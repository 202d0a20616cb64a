"""The kernel's own sine and cosine: a wrong last digit is in every row."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from testbed.kernel.constants import NB, PER_PI, PI, ROUND
from testbed.kernel.screws import sine_cosine

PI_DIGITS = Fraction(314159265358979323846264338327950288419716939937510, 10**50)


def test_whole_turns_are_taken_off_without_rounding() -> None:
    assert abs(sum(map(Fraction, PI)) - PI_DIGITS) < Fraction(1, 10**36)
    assert 1 / math.pi == PER_PI
    for n in (1, 2, 3, 1000, 99_999, 1_000_003):
        assert all(Fraction(part) * n == Fraction(part * n) for part in PI[:2])
    for x in (0.4, 0.6, -0.6, 2.5, 3.5, 1e9 + 0.7):
        assert (x + ROUND) - ROUND == round(x)


def test_sines_and_cosines_are_right_to_rounding() -> None:
    rng = np.random.default_rng(0)
    for span in (1.0, 4.0, 100.0, 1e4):
        for shift in (0.0, 0.3, -math.pi / 2):
            q = rng.uniform(-span, span, NB)
            s, c = np.zeros(NB), np.zeros(NB)
            sine_cosine(q, shift, s, c)
            np.testing.assert_allclose(s, np.sin(q + shift), rtol=0, atol=3e-16)
            np.testing.assert_allclose(c, np.cos(q + shift), rtol=0, atol=3e-16)
