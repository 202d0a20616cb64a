"""What repeats with the motion is told from noise."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.repetition import Repetition, RepetitionSums
from testbed.identification.period import period_of

NOISES = {
    "white": Autoregression(np.zeros((6, 0)), np.arange(1.0, 7.0)),
    "coloured": Autoregression(np.tile([0.6, 0.2], (6, 1)), np.ones(6)),
}


def made(noise: Autoregression, rows: int, seed: int) -> Array:
    return NoiseMaker(noise, 1, np.random.default_rng(seed)).rows(rows)[..., 0]


def found(noise: Autoregression, period: int, left: Array, cut: int = 10**9) -> Repetition:
    sums = RepetitionSums(noise, period, 10.0)
    for first in range(0, left.shape[1], cut):
        sums.add(left[:, first : first + cut])
    result = sums.found()
    assert result is not None
    return result


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISES)
def test_chances_in_noise_are_no_smaller_than_they_say(noise: str) -> None:
    chances = [found(NOISES[noise], 100, made(NOISES[noise], 200, s)).chance for s in range(400)]
    for level in (0.05, 0.25, 0.5, 0.75, 0.95):
        share = np.mean(np.array(chances) < level)
        assert share < level + 4 * np.sqrt(level * (1 - level) / 400)
    assert np.mean(np.array(chances) < 0.25) > 0.08  # nor useless
    assert min(chances) > 1e-5


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("periods", [2, 5])
def test_what_repeats_is_found_with_its_share(noise: str, periods: int) -> None:
    """A part of one channel twice as large as its noise: four fifths of it repeat."""
    law, rng = NOISES[noise], np.random.default_rng(5)
    left = made(law, 100 * periods, 3)
    white = Autoregression(law.coefficients, np.where(np.arange(6) == 2, law.sigma, 0.0))
    once = NoiseMaker(white, 1, rng).rows(100)[..., 0]
    again = found(law, 100, left + 2 * np.tile(once, periods))
    assert again.chance < 1e-4
    assert again.period == 10.0
    shares = np.array(again.share)
    assert shares.argmax() == 2
    assert abs(shares[2] - 0.8) < 0.1
    assert np.all(np.abs(np.delete(shares, 2)) < 0.4)


@pytest.mark.parametrize("cut", [1, 7, 100, 150])
def test_cuts_leave_no_trace(cut: int) -> None:
    left = made(NOISES["coloured"], 350, 1)
    whole, pieces = (found(NOISES["coloured"], 100, left, each) for each in (10**9, cut))
    np.testing.assert_allclose(whole.share, pieces.share, rtol=1e-12)
    assert whole.chance == pytest.approx(pieces.chance, rel=1e-9)


def test_too_few_rows_say_nothing() -> None:
    sums = RepetitionSums(NOISES["white"], 100, 10.0)
    sums.add(made(NOISES["white"], 104, 1))
    assert sums.found() is None


def motion(period: float, samples: int, joints: int, rng: np.random.Generator) -> Array:
    """A Fourier series of five harmonics, and noise of an encoder."""
    phase = 2 * np.pi * np.arange(samples)[:, None, None] / period * np.arange(1, 6)
    size = rng.normal(size=(2, joints, 5))
    wave = (size[0] * np.sin(phase) + size[1] * np.cos(phase)).sum(axis=2)
    return np.asarray(wave + 1e-3 * rng.normal(size=wave.shape))


@pytest.mark.parametrize("seed", range(20))
def test_the_period_of_a_motion_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    period = int(rng.integers(200, 2000))
    joints = int(rng.integers(1, 8))
    assert period_of(motion(period, 2 * period + 7, joints, rng)) == pytest.approx(period, abs=2)
    assert period_of(motion(period, int(1.4 * period), joints, rng)) is None


def test_a_joint_that_stands_still_hides_no_period() -> None:
    rng = np.random.default_rng(1)
    moving = motion(500, 1100, 2, rng)
    still = 1e-4 * rng.normal(size=(1100, 1))
    assert period_of(np.hstack([moving, still, np.zeros((1100, 1))])) == pytest.approx(500, abs=2)


@pytest.mark.parametrize("kind", ["random walk", "rest", "chirp", "short"])
def test_other_motions_have_none(kind: str) -> None:
    rng = np.random.default_rng(2)
    time = np.arange(3000) / 3000
    position = {
        "random walk": np.cumsum(rng.normal(size=(3000, 2)), axis=0),
        "rest": np.zeros((3000, 2)),
        "chirp": np.sin(2 * np.pi * 20 * time**2)[:, None],
        "short": np.arange(3.0)[:, None],
    }[kind]
    assert period_of(position) is None


def test_what_repeats_a_little_in_every_channel_is_found_by_all_together() -> None:
    """No channel alone would tell."""
    law, chances = NOISES["white"], []
    for seed in range(9):
        once = made(law, 100, 50 + seed)
        again = found(law, 100, made(law, 200, seed) + 0.5 * np.tile(once, 2))
        chances.append(again.chance)
    assert np.median(chances) < 1e-4
