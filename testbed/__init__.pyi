from .applications.payload.payload import payload as payload
from .bodies.consistency.consistent import consistent as consistent
from .bodies.consistency.consistent import robot_of as robot_of
from .bodies.consistency.robot_posterior import prior as prior
from .bodies.consistency.robot_posterior import write_model as write_model
from .bodies.consistency.robots import robots as robots
from .bodies.prior import prior_of as prior_of
from .core.base.diagnostics import Diagnostic as Diagnostic
from .core.base.diagnostics import sentences as sentences
from .core.base.errors import TestbedError as TestbedError
from .core.base.installation import __version__ as __version__
from .core.base.installation import shipped as shipped
from .core.dynamics.newton_euler import Motion as Motion
from .core.dynamics.newton_euler import base_wrench as base_wrench
from .core.dynamics.newton_euler import joint_forces as joint_forces
from .core.dynamics.newton_euler import pedestal_wrench as pedestal_wrench
from .core.dynamics.regressor import regressor as regressor
from .core.estimation.estimate import Estimate as Estimate
from .core.estimation.identify import identify as identify
from .core.estimation.information import Information as Information
from .core.estimation.regression.normal_equations import (
    NormalEquations as NormalEquations,
)
from .core.estimation.regression.solvers import fit as fit
from .core.estimation.settings import Settings as Settings
from .core.parameters.joint_terms import DriveSet as DriveSet
from .core.parameters.joint_terms import with_joint_terms as with_joint_terms
from .core.parameters.minimal_set import MinimalSet as MinimalSet
from .core.parameters.minimal_set import minimal_set as minimal_set
from .core.parameters.minimal_set import selection as selection
from .core.parameters.symbols import barycentric as barycentric
from .core.parameters.symbols import standard as standard
from .core.recordings.held import hold_still as hold_still
from .core.recordings.joined import Joined as Joined
from .core.recordings.recording import Recording as Recording
from .core.recordings.source import StoredRecording as StoredRecording
from .core.robot.force_sensor import ForceSensor as ForceSensor
from .core.robot.inertia import Inertia as Inertia
from .core.robot.model_file import ModelFile as ModelFile
from .core.robot.model_file import load_tree as load_tree
from .core.robot.shafts import with_shafts as with_shafts
from .core.robot.tree import Joint as Joint
from .core.robot.tree import Tree as Tree
from .equations.compare import compare_equations as compare_equations
from .equations.equations import Listing as Listing
from .equations.equations import equations as equations
from .equations.languages import write_equations as write_equations
from .importing.check.read import read as read
from .importing.convert import import_recording as import_recording
from .lab.experiment.carry_out import carry_out as carry_out
from .lab.experiment.design import design as design
from .lab.experiment.experiment import Experiment as Experiment
from .lab.experiment.predict import predict as predict
from .lab.experiment.record import record as record
from .lab.experiment.rig import Rig as Rig
from .lab.experiment.rig import rig_of as rig_of
from .lab.experiment.run import Run as Run
from .lab.experiment.run import assemble_run as assemble_run
from .lab.experiment.sensors import Encoders as Encoders
from .lab.experiment.sensors import ForcePlate as ForcePlate
from .lab.experiment.sensors import JointTorques as JointTorques
from .lab.experiment.simulate import simulate as simulate
from .lab.experiment.validate import validate as validate
from .lab.simulation.bodies import CompliantPlate as CompliantPlate
from .lab.simulation.bodies import GearedRotor as GearedRotor
from .lab.simulation.bodies import Payload as Payload
from .lab.simulation.bodies import Tilt as Tilt
from .lab.simulation.joint_friction import FrictionTerm as FrictionTerm
from .lab.simulation.joint_friction import LoadFriction as LoadFriction
from .lab.simulation.joint_friction import LuGreFriction as LuGreFriction
from .lab.simulation.joint_friction import Stribeck as Stribeck
from .lab.simulation.joint_friction import WarmingDrives as WarmingDrives
from .motion.fourier import Fourier as Fourier
from .motion.random_motion import random_motion as random_motion
from .motion.rest_to_rest import RestToRest as RestToRest
from .sensors.errors.encoder_delay import EncoderDelay as EncoderDelay
from .sensors.errors.encoder_eccentricity import (
    EncoderEccentricity as EncoderEccentricity,
)
from .sensors.errors.encoder_gain import EncoderGain as EncoderGain
from .sensors.errors.encoder_instant_sampling import (
    EncoderInstantSampling as EncoderInstantSampling,
)
from .sensors.errors.encoder_noise import EncoderNoise as EncoderNoise
from .sensors.errors.encoder_resolution import EncoderResolution as EncoderResolution
from .sensors.errors.encoder_zero_error import EncoderZeroError as EncoderZeroError
from .sensors.errors.measured_tare import MeasuredTare as MeasuredTare
from .sensors.errors.plate_anti_alias_filter import (
    PlateAntiAliasFilter as PlateAntiAliasFilter,
)
from .sensors.errors.plate_bias import PlateBias as PlateBias
from .sensors.errors.plate_clock_rate import PlateClockRate as PlateClockRate
from .sensors.errors.plate_coloured_noise import (
    PlateColouredNoise as PlateColouredNoise,
)
from .sensors.errors.plate_converter import PlateConverter as PlateConverter
from .sensors.errors.plate_crosstalk import PlateCrosstalk as PlateCrosstalk
from .sensors.errors.plate_delay import PlateDelay as PlateDelay
from .sensors.errors.plate_drift import PlateDrift as PlateDrift
from .sensors.errors.plate_dropped_samples import (
    PlateDroppedSamples as PlateDroppedSamples,
)
from .sensors.errors.plate_gain import PlateGain as PlateGain
from .sensors.errors.plate_hum import PlateHum as PlateHum
from .sensors.errors.plate_matrix import PlateMatrix as PlateMatrix
from .sensors.errors.plate_noise import PlateNoise as PlateNoise
from .sensors.errors.plate_origin_height import PlateOriginHeight as PlateOriginHeight
from .sensors.errors.plate_pink_noise import PlatePinkNoise as PlatePinkNoise
from .sensors.errors.plate_pose import PlatePose as PlatePose
from .sensors.errors.plate_random_walk import PlateRandomWalk as PlateRandomWalk
from .sensors.errors.plate_saturation import PlateSaturation as PlateSaturation
from .sensors.errors.plate_tare import PlateTare as PlateTare
from .sensors.errors.torque_constant_error import (
    TorqueConstantError as TorqueConstantError,
)
from .sensors.errors.torque_noise import TorqueNoise as TorqueNoise
from .sensors.errors.torque_offset import TorqueOffset as TorqueOffset
from .view.plot import plot as plot
from .view.run_page import report as report
from .view.viewer.log import view as view
