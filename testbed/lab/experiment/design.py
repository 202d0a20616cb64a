"""Design of an informative, safe motion for a rig with a force plate."""

from __future__ import annotations

import numpy as np

from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Signal
from testbed.lab.experiment.excite import DEFAULT_TORQUE_NOISE, pipeline
from testbed.lab.experiment.motions import DEFAULT_PLATE_NOISE
from testbed.lab.experiment.rig import Rig
from testbed.motion.design import DesignProblem
from testbed.motion.excite import excite
from testbed.motion.fourier import Fourier
from testbed.motion.information import information_of
from testbed.motion.limits import joint_limits
from testbed.motion.samples import SampledRows
from testbed.motion.surroundings import find_watched_pairs, motion_constraints
from testbed.motion.terms import PlateRange, PlateTerm

MARGIN = 0.95
"""Share of every limit that a motion may use."""

CLEARANCE = 0.02
"""Smallest distance between bodies without a common joint, and to the plate [m]."""


def design(
    rig: Rig, motion: Fourier, seconds: float = 60.0, starts: int = 6, seed: int = 0
) -> Fourier:
    """Design the excitation trajectory that minimises the standard deviations from the plate.

    The joint positions, velocities, efforts and the plate's wrench are proven to stay within their
    limits times `MARGIN` at all times, and the distances between bodies to stay above `CLEARANCE`.

    Args:
        rig: Robot, plant and sensors; zero noise is replaced by a default.
        motion: Fourier series that sets the fundamental frequency and the number of harmonics.
        seconds: Length of the recording [s].
        starts: Number of searches, each from another random motion; the best result is returned.
        seed: Seed of the random motions.

    Raises:
        InfeasibleMotion: No motion inside the limits was found.
    """
    tree, instrument = rig.true_robot, rig.instrument
    limits = joint_limits(tree)
    environment = find_watched_pairs(tree, limits, CLEARANCE)
    plate_range = PlateRange(np.array(instrument.full_scale))
    plate = PlateTerm(plate_range, pedestal_wrench(tree), MARGIN)
    rules = motion_constraints(tree, limits, MARGIN, [plate], environment)
    rows: dict[Signal, SampledRows] = {
        term.model: SampledRows(tree, minimal_set(tree, term.model))
        for term in rules.force_limits
    }
    information = information_of(
        rows,
        "plate",
        instrument.plate_noise if instrument.plate_noise.all() else DEFAULT_PLATE_NOISE,
        np.full(tree.n, instrument.torque_noise or DEFAULT_TORQUE_NOISE),
    )
    problem = DesignProblem(
        rules=rules,
        information=information,
        rows=rows,
        pipeline=pipeline(rig.rate, seconds, sensed=instrument.senses_kinematics),
        frequencies=((motion.fundamental, motion.harmonics),),
        search_count=starts,
        seed=seed,
    )
    return excite(problem).design.motion
