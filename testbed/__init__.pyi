from .diagnostics import (
    Diagnostic as Diagnostic,
)
from .diagnostics import (
    sentences as sentences,
)
from .dynamics.newton_euler import Motion as Motion
from .dynamics.newton_euler import (
    base_wrench as base_wrench,
)
from .dynamics.newton_euler import (
    joint_forces as joint_forces,
)
from .dynamics.newton_euler import (
    pedestal_wrench as pedestal_wrench,
)
from .dynamics.newton_euler import (
    regressor as regressor,
)
from .errors import TestbedError as TestbedError
from .excitation.random_motion import random_motion as random_motion
from .experiment.carry_out import carry_out as carry_out
from .experiment.experiment import Experiment as Experiment
from .experiment.predict import predict as predict
from .experiment.run import (
    Run as Run,
)
from .experiment.run import (
    assemble_run as assemble_run,
)
from .experiment.simulate import simulate as simulate
from .identification.consistency.consistent import (
    consistent as consistent,
)
from .identification.consistency.consistent import (
    robot_of as robot_of,
)
from .identification.consistency.robots import robots as robots
from .identification.estimate import Estimate as Estimate
from .identification.identify import identify as identify
from .identification.payload.payload import payload as payload
from .identification.regression.normal_equations import NormalEquations as NormalEquations
from .identification.regression.solvers import fit as fit
from .identification.settings import Settings as Settings
from .identification.validate import validate as validate
from .installation import shipped as shipped
from .parameters.joint_terms import (
    DriveSet as DriveSet,
)
from .parameters.joint_terms import (
    with_joint_terms as with_joint_terms,
)
from .parameters.minimal_set import (
    MinimalSet as MinimalSet,
)
from .parameters.minimal_set import (
    minimal_set as minimal_set,
)
from .parameters.minimal_set import (
    selection as selection,
)
from .parameters.prior import prior_of as prior_of
from .parameters.symbols import (
    barycentric as barycentric,
)
from .parameters.symbols import (
    standard as standard,
)
from .recordings.held import hold_still as hold_still
from .recordings.joined import Joined as Joined
from .recordings.recording import (
    Recording as Recording,
)
from .recordings.source import StoredRecording as StoredRecording
from .reporting.plot import plot as plot
from .reporting.run_page import report as report
from .robot.force_sensor import ForceSensor as ForceSensor
from .robot.inertia import Inertia as Inertia
from .robot.locks import with_shafts as with_shafts
from .robot.model_file import (
    ModelFile as ModelFile,
)
from .robot.model_file import (
    load_tree as load_tree,
)
from .robot.tree import (
    Joint as Joint,
)
from .robot.tree import (
    Tree as Tree,
)
from .robot.write_model import write_model as write_model
from .symbolic.compare import compare_equations as compare_equations
from .symbolic.equations import (
    Listing as Listing,
)
from .symbolic.equations import (
    equations as equations,
)
from .symbolic.languages import write_equations as write_equations
from .viewer.log import view as view
