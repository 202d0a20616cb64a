"""All that the plate says of the drives: constants and terms, friction curves, both combined."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from testbed.codec import with_properties
from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic
from testbed.identification.drives.friction_curves import FrictionCurve, friction_curves
from testbed.identification.drives.fusion import Combined, combined
from testbed.identification.drives.joint_regression import regressions, torques_beside
from testbed.identification.drives.joint_terms import choices, offered
from testbed.identification.drives.torque_constants import ChosenTerms, DriveEstimate
from testbed.identification.estimate import Estimate
from testbed.identification.problem import Problem
from testbed.identification.regression.passes import Progress
from testbed.identification.settings import DEFAULTS, Settings
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
from testbed.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class DriveFindings(Diagnosed):
    """What a recording's joint torques are, beside the plate's estimate.

    Attributes:
        estimates: Constants and terms, one a joint.
        curves: Friction over velocity, one a joint.
        combined: The bodies by plate and torques together.
    """

    estimates: tuple[DriveEstimate, ...]
    curves: tuple[FrictionCurve, ...]
    combined: Combined

    __get_pydantic_core_schema__ = with_properties("diagnostics")

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What a careful reader should know."""
        return self.combined.disagreement.diagnostics


def identify_drives(
    tree: Tree,
    recording: Recording | Source | str,
    bodies: Estimate,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    choose: bool = False,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> DriveFindings:
    """Torque constants, the joints' own terms and friction curves; plate and torques together.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: With joint torques, as for `identify`.
        bodies: The external estimate: of this recording or of another.
        gravity: (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: How the signals are treated, and which terms are looked for.
        choose: Choose each joint's terms by held-out data; of those in the settings, only a
            rotor's inertia counts then.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording has no torques, or is of another robot.
        SettingsError: The estimate is not the plate's, or not of these parameters.
    """
    problem = Problem.of(
        tree,
        recording,
        "internal",
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
    )
    settings = problem.settings
    choose = choose or settings.open_speed  # which is chosen with the terms
    torques = torques_beside(problem, bodies, offered(settings.laws) if choose else None)
    chosen = ChosenTerms(choices(torques) if choose else None)
    found = regressions(torques, bodies, chosen.pick)
    curves = friction_curves(problem, bodies)
    return DriveFindings(
        chosen.estimates(problem.tree, torques, found), curves, combined(torques, bodies, found)
    )
