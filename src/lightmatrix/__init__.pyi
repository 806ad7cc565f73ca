# The public names of `import lightmatrix as lm`, each with the file that defines it. `__init__.py`
# reads this list and loads a name when it is first used. Each heading is a page of the reference.

from ._version import __version__ as __version__

# Patterns.
from .patterns.bits import BernoulliPatterns as BernoulliPatterns, BitPatterns as BitPatterns
from .patterns.blocks import BlockPatterns as BlockPatterns
from .patterns.colour import ColourPatterns as ColourPatterns, colour_bernoulli as colour_bernoulli
from .patterns.folder import read_patterns as read_patterns, write_patterns as write_patterns
from .patterns.making import make_patterns as make_patterns
from .patterns.pattern_set import ImagePatterns as ImagePatterns, PatternSet as PatternSet

# Captures, photographed and simulated.
from .capture.decoder import Decoder as Decoder
from .capture.camera_curve import Response as Response
from .capture.samples import Samples as Samples
from .capture.sensor import Sensor as Sensor
from .capture.capture import Capture as Capture
from .capture.convert import convert as convert
from .capture.packing import pack as pack
from .capture.settings import ReadSettings as ReadSettings
from .files.images import read_image as read_image, write_image as write_image
from .simulation.library import scenes as scenes, truth as truth
from .simulation.simulate import simulate as simulate
from .simulation.procedural import ProceduralScene as ProceduralScene
from .simulation.renderer import render as render
from .simulation.truth import Truth as Truth

# Rigs that photograph, real and virtual.
from .rig.rig_measurements import RigMeasurements as RigMeasurements, measure_rig as measure_rig
from .rig.capturing import CaptureSettings as CaptureSettings
from .rig.capturing import take_capture as take_capture
from .rig.devices.registry import (
    list_devices as list_devices,
    open_camera as open_camera,
    open_projector as open_projector,
)
from .rig.rig import open_rig as open_rig
from .rig.showing import project as project

# Geometry of a rig.
from .shape.calibrate import calibrate_rig as calibrate_rig, self_calibrate as self_calibrate
from .geometry.rig_geometry import RigGeometry as RigGeometry

# What is wrong with a capture.
from .estimators.rig_findings import check as check

# Responses, measured from photographs.
from .patterns.projector_curve import ProjectorResponse as ProjectorResponse
from .responses.curves import (
    camera_response as camera_response,
    projector_response as projector_response,
)

# Estimates.
from .estimators.estimate import estimate as estimate
from .estimators.corrected import fit_rig as fit_rig
from .rig_model.model import RigModel as RigModel
from .estimators.colour import estimate_colour as estimate_colour
from .estimators.resource_estimate import estimate_resources as estimate_resources
from .estimators.settings import EstimateSettings as EstimateSettings
from .estimators.tracking import Tracker as Tracker
from .estimators.unknown_response import find_response as find_response
from .solvers import (
    ADMM as ADMM,
    ROMP as ROMP,
    ActiveSet as ActiveSet,
    Fidelity as Fidelity,
    Problem as Problem,
    Result as Result,
    SaturationADMM as SaturationADMM,
    TotalVariation as TotalVariation,
    solve as solve,
)

# Correspondence without T, from stripes.
from .shape.decode import decode as decode
from .transport.npz import read_correspondence as read_correspondence

# What is done with them.
from .pictures.relight import relight as relight
from .report.make import report as report
from .viewer.export import export_viewer as export_viewer
from .viewer.notebook import view as view
from .viewer.server import serve_viewer as serve_viewer
from .judgement.evaluate import evaluate as evaluate
from .judgement.evaluate import evaluate_colour as evaluate_colour
from .transport.column_index import ColumnIndex as ColumnIndex, index_columns as index_columns
from .transport.store import StoredTransport as StoredTransport, open as open, save as save
from .transport.npz import export as export
from .transport.store import open_colour as open_colour, save_colour as save_colour
from .transport.matrix import ColourTransport as ColourTransport
from .transport.correspondence import (
    Correspondence as Correspondence,
    correspondence as correspondence,
)
from .transport.matrix import LightTransport as LightTransport
from .uses.compensation import (
    cancel_global as cancel_global,
    compensate as compensate,
    compensate_video as compensate_video,
)
from .rig.closed_loop import refine_compensation as refine_compensation
from .uses.projector_map import (
    ProjectorMap as ProjectorMap,
    map_projector as map_projector,
    map_projectors as map_projectors,
)
from .report.views import show as show
from .shape.triangulation import geometry_of as geometry_of, triangulate as triangulate
from .shape.layers import layers as layers
from .uses.separation import separate as separate
from .judgement.judgement import Verdicts as Verdicts, verdicts as verdicts

# Plans and the demo.
from .demo import demo as demo
from .planning.plan import plan as plan

# Errors.
from .errors import (
    ClusterError as ClusterError,
    DeviceError as DeviceError,
    FrameTimeoutError as FrameTimeoutError,
    InputError as InputError,
    LightMatrixError as LightMatrixError,
    LightMatrixWarning as LightMatrixWarning,
    MissingExtraError as MissingExtraError,
    OutputError as OutputError,
    SolverError as SolverError,
)
