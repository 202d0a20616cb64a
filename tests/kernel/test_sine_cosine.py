"""Sine and cosine of the kernel: where their polynomials come from, and how good they are."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from testbed.kernel.constants import COSINE, NB, PER_PI, PI, ROUND, SINE
from testbed.kernel.screws import sine_cosine

HALF_PI_SQUARED = Fraction(math.pi / 2) ** 2
TERMS = 24
PI_DIGITS = Fraction(314159265358979323846264338327950288419716939937510, 10**50)


def remainder(z: Fraction, skip: int) -> Fraction:
    """Taylor's series of sine or cosine in z = r^2, less its first terms, over r^skip."""
    total = Fraction(0)
    for k in range(TERMS):
        sign = (-1) ** (k + skip // 2)
        total += Fraction(sign, math.factorial(2 * k + skip)) * z**k
    return total


def interpolated(skip: int, nodes: int) -> list[Fraction]:
    """Coefficients, highest first, of the polynomial through values at Chebyshev's nodes."""
    at = [
        HALF_PI_SQUARED / 2 * (1 + Fraction(math.cos(math.pi * (2 * k + 1) / (2 * nodes))))
        for k in range(nodes)
    ]
    newton = [remainder(z, skip) for z in at]
    for level in range(1, nodes):
        for k in range(nodes - 1, level - 1, -1):
            newton[k] = (newton[k] - newton[k - 1]) / (at[k] - at[k - level])
    powers = [newton[-1]]
    for k in range(nodes - 2, -1, -1):  # times (z - at[k]), plus newton[k]
        shifted = [*powers, Fraction(0)]
        for i, coefficient in enumerate(powers):
            shifted[i + 1] -= at[k] * coefficient
        shifted[-1] += newton[k]
        powers = shifted
    return powers


@pytest.mark.parametrize(("coefficients", "skip"), [(SINE, 3), (COSINE, 4)])
def test_the_polynomials_are_interpolations(coefficients: tuple[float, ...], skip: int) -> None:
    expected = interpolated(skip, len(coefficients))
    for found, value in zip(coefficients, expected, strict=True):
        assert abs(Fraction(found) / value - 1) < Fraction(1, 10**8)
    worst = 0.0
    for k in range(200):
        z, total = HALF_PI_SQUARED * Fraction(k, 199), Fraction(0)
        for coefficient in coefficients:
            total = total * z + Fraction(coefficient)
        worst = max(worst, abs(float(total - remainder(z, skip))))
    assert worst < 1.2e-17


def test_pi_is_whole_in_three_parts() -> None:
    assert abs(sum(map(Fraction, PI)) - PI_DIGITS) < Fraction(1, 10**36)
    assert 1 / math.pi == PER_PI
    for n in (1, 2, 3, 1000, 99_999, 1_000_003):
        assert all(Fraction(part) * n == Fraction(part * n) for part in PI[:2])
    for x in (0.4, 0.6, -0.6, 2.5, 3.5, 1e9 + 0.7):
        assert (x + ROUND) - ROUND == round(x)


@pytest.mark.parametrize("span", [1.0, 4.0, 100.0, 1e4])
def test_sines_and_cosines_are_right_to_rounding(span: float) -> None:
    rng = np.random.default_rng(0)
    for shift in (0.0, 0.3, -math.pi / 2):
        q = rng.uniform(-span, span, NB)
        s, c = np.zeros(NB), np.zeros(NB)
        sine_cosine(q, shift, s, c)
        np.testing.assert_allclose(s, np.sin(q + shift), rtol=0, atol=3e-16)
        np.testing.assert_allclose(c, np.cos(q + shift), rtol=0, atol=3e-16)
