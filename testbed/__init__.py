"""A virtual force plate under a robot: minimal dynamic parameters, two ways.

What is named here is promised; it is imported when first used, so that the command line
answers at once.

Source    [FRS96], see REFERENCES.bib
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from testbed.diagnostics.diagnostic import Diagnostic as Diagnostic
    from testbed.diagnostics.diagnostic import sentences as sentences
    from testbed.dynamics.inverse_dynamics import base_wrench as base_wrench
    from testbed.dynamics.inverse_dynamics import joint_forces as joint_forces
    from testbed.dynamics.inverse_dynamics import pedestal_wrench as pedestal_wrench
    from testbed.dynamics.inverse_dynamics import regressor as regressor
    from testbed.dynamics.motion import Motion as Motion
    from testbed.errors import TestbedError as TestbedError
    from testbed.excitation.random_motion import random_motion as random_motion
    from testbed.experiment.carry_out import carry_out as carry_out
    from testbed.experiment.comparison import Comparison as Comparison
    from testbed.experiment.comparison import compare as compare
    from testbed.experiment.experiment import Experiment as Experiment
    from testbed.experiment.predictions import predict as predict
    from testbed.experiment.run import Run as Run
    from testbed.experiment.run import assemble_run as assemble_run
    from testbed.experiment.simulate import simulate as simulate
    from testbed.identification.consistency.consistent import consistent as consistent
    from testbed.identification.consistency.consistent import robot_of as robot_of
    from testbed.identification.estimate import Estimate as Estimate
    from testbed.identification.identify import identify as identify
    from testbed.identification.payload.payload import payload as payload
    from testbed.identification.regression.normal_equations import (
        NormalEquations as NormalEquations,
    )
    from testbed.identification.regression.solvers import fit as fit
    from testbed.identification.settings import Settings as Settings
    from testbed.identification.validate import validate as validate
    from testbed.installation import shipped as shipped
    from testbed.parameters.barycentric import barycentric as barycentric
    from testbed.parameters.barycentric import standard as standard
    from testbed.parameters.joint_terms import DriveSet as DriveSet
    from testbed.parameters.joint_terms import with_joint_terms as with_joint_terms
    from testbed.parameters.minimal_set import MinimalSet as MinimalSet
    from testbed.parameters.minimal_set import minimal_set as minimal_set
    from testbed.parameters.minimal_set import selection as selection
    from testbed.parameters.prior import prior_of as prior_of
    from testbed.recordings.joined import Joined as Joined
    from testbed.recordings.recording import Recording as Recording
    from testbed.recordings.recording import import_recording as import_recording
    from testbed.recordings.stored import StoredRecording as StoredRecording
    from testbed.reporting.plot import plot as plot
    from testbed.reporting.run_page import report as report
    from testbed.robot.inertia import Inertia as Inertia
    from testbed.robot.model_file import ModelFile as ModelFile
    from testbed.robot.model_file import load_tree as load_tree
    from testbed.robot.transmission import with_shafts as with_shafts
    from testbed.robot.tree import Joint as Joint
    from testbed.robot.tree import Tree as Tree
    from testbed.robot.write_model import write_model as write_model
    from testbed.symbolic.compare import compare_equations as compare_equations
    from testbed.symbolic.equations import Listing as Listing
    from testbed.symbolic.equations import equations as equations
    from testbed.symbolic.languages import write_equations as write_equations
    from testbed.viewer.view import view as view

_HOMES = {
    "testbed.diagnostics.diagnostic": ("Diagnostic", "sentences"),
    "testbed.experiment.carry_out": ("carry_out",),
    "testbed.experiment.simulate": ("simulate",),
    "testbed.experiment.experiment": ("Experiment",),
    "testbed.dynamics.inverse_dynamics": (
        "base_wrench",
        "joint_forces",
        "pedestal_wrench",
        "regressor",
    ),
    "testbed.dynamics.motion": ("Motion",),
    "testbed.errors": ("TestbedError",),
    "testbed.identification.estimate": ("Estimate",),
    "testbed.identification.identify": ("identify",),
    "testbed.identification.settings": ("Settings",),
    "testbed.identification.regression.normal_equations": ("NormalEquations",),
    "testbed.identification.regression.solvers": ("fit",),
    "testbed.identification.validate": ("validate",),
    "testbed.recordings.joined": ("Joined",),
    "testbed.recordings.stored": ("StoredRecording",),
    "testbed.recordings.recording": (
        "import_recording",
        "Recording",
    ),
    "testbed.parameters.barycentric": ("barycentric", "standard"),
    "testbed.parameters.joint_terms": ("DriveSet", "with_joint_terms"),
    "testbed.parameters.minimal_set": ("MinimalSet", "minimal_set", "selection"),
    "testbed.symbolic.compare": ("compare_equations",),
    "testbed.symbolic.equations": ("Listing", "equations"),
    "testbed.symbolic.languages": ("write_equations",),
    "testbed.robot.inertia": ("Inertia",),
    "testbed.robot.transmission": ("with_shafts",),
    "testbed.robot.tree": ("Joint", "Tree"),
    "testbed.experiment.comparison": (
        "Comparison",
        "compare",
    ),
    "testbed.experiment.predictions": ("predict",),
    "testbed.experiment.run": (
        "Run",
        "assemble_run",
    ),
    "testbed.excitation.random_motion": ("random_motion",),
    "testbed.installation": ("shipped",),
    "testbed.reporting.run_page": ("report",),
    "testbed.reporting.plot": ("plot",),
    "testbed.viewer.view": ("view",),
    "testbed.identification.payload.payload": ("payload",),
    "testbed.identification.consistency.consistent": (
        "consistent",
        "robot_of",
    ),
    "testbed.parameters.prior": ("prior_of",),
    "testbed.robot.model_file": ("ModelFile", "load_tree"),
    "testbed.robot.write_model": ("write_model",),
}

_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)  # noqa: PLE0605


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'testbed' has no attribute '{name}'")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return sorted((*globals(), *_HOME_OF))
