"""Design the motion of a rig: the most informative one for its plate, proven safe."""

from __future__ import annotations

import numpy as np

from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Model
from testbed.lab.experiment.excite import QUIET_TORQUE, pipeline
from testbed.lab.experiment.motions import QUIET_PLATE
from testbed.lab.experiment.rig import Rig
from testbed.motion.design import DesignProblem
from testbed.motion.excite import excite
from testbed.motion.fourier import Fourier
from testbed.motion.information import information_of
from testbed.motion.limits import limits_of
from testbed.motion.samples import SampledRows
from testbed.motion.surroundings import rules_within, surroundings
from testbed.motion.terms import PlateRange, PlateTerm

MARGIN = 0.95
"""Share of every limit that a motion may use."""

CLEARANCE = 0.02
"""Distance kept by bodies that no joint joins, and to the plate [m]."""


def design(
    rig: Rig, motion: Fourier, seconds: float = 60.0, starts: int = 6, seed: int = 0
) -> Fourier:
    """Design a motion for the most precise parameters by the plate.

    Limits of positions, velocities, efforts, the plate's range and distances between bodies are
    proven to hold at every moment.

    Args:
        rig: Robot, plant and sensors.
        motion: A motion with the fundamental frequency and number of harmonics wanted.
        seconds: Length of the recording to be made [s].
        starts: Searches, each from another random motion; the best result is taken.
        seed: Of these random motions.

    Raises:
        InfeasibleMotion: No motion inside the limits was found.
    """
    tree, how = rig.true_robot, rig.instrument
    limits = limits_of(tree)
    around = surroundings(tree, limits, CLEARANCE)
    reach = PlateRange(np.array(how.full_scale))
    plate = PlateTerm(reach, pedestal_wrench(tree), MARGIN)
    rules = rules_within(tree, limits, MARGIN, [plate], around)
    rows: dict[Model, SampledRows] = {
        term.model: SampledRows(tree, minimal_set(tree, term.model))
        for term in rules.terms
    }
    information = information_of(
        rows,
        "plate",
        how.plate_noise if how.plate_noise.all() else QUIET_PLATE,
        np.full(tree.n, how.torque_noise or QUIET_TORQUE),
    )
    problem = DesignProblem(
        rules=rules,
        information=information,
        rows=rows,
        pipeline=pipeline(rig.rate, seconds, sensed=how.senses_kinematics),
        frequencies=((motion.fundamental, motion.harmonics),),
        starts=starts,
        seed=seed,
    )
    return excite(problem).design.motion
