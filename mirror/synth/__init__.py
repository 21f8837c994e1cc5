"""A procedural street with exact ground truth: the data of the demo, of the tests and of accuracy benchmarks.

The names below are all that other packages import of it; they are imported on first use. import-linter holds this.
"""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.synth.driving.bodies import POPULATION as POPULATION
    from mirror.synth.driving.bodies import get_body as get_body
    from mirror.synth.errors import Errors as Errors
    from mirror.synth.fleet import PRESETS as PRESETS
    from mirror.synth.fleet.drive import SynthDrive as SynthDrive
    from mirror.synth.fleet.drives import make_drive as make_drive
    from mirror.synth.fleet.drives import make_drives as make_drives
    from mirror.synth.hidden_truth import write_hidden_truth as write_hidden_truth
    from mirror.synth.light.condition import Condition as Condition
    from mirror.synth.light.condition import Effects as Effects
    from mirror.synth.light.sun import instant_of as instant_of
    from mirror.synth.maps import street_map as street_map
    from mirror.synth.model import Label as Label
    from mirror.synth.model import Model as Model
    from mirror.synth.render.coverage import SKY as SKY
    from mirror.synth.render.develop.camera_response import CameraResponse as CameraResponse
    from mirror.synth.render.develop.developing import develop as develop
    from mirror.synth.render.lens import Lens as Lens
    from mirror.synth.render.lens import cut_line as cut_line
    from mirror.synth.render.lens import make_lens as make_lens
    from mirror.synth.render.scene import Instant as Instant
    from mirror.synth.render.scene import RenderedImage as RenderedImage
    from mirror.synth.render.scene import RollingImage as RollingImage
    from mirror.synth.render.scene import Scene as Scene
    from mirror.synth.render.surfaces import SurfaceBuffer as SurfaceBuffer
    from mirror.synth.render.surroundings import Surroundings as Surroundings
    from mirror.synth.render.view import RasterizedView as RasterizedView
    from mirror.synth.render.view import rasterize_view as rasterize_view
    from mirror.synth.rigs.readouts import parse_readouts as parse_readouts
    from mirror.synth.road_users.body import Body as Body
    from mirror.synth.road_users.body import RoadUser as RoadUser
    from mirror.synth.roads.markings import MARK as MARK
    from mirror.synth.seeds import parse_public_seed as parse_public_seed
    from mirror.synth.truth import Truth as Truth
    from mirror.synth.truth.casting import cast_rays as cast_rays
    from mirror.synth.writing import SynthReport as SynthReport
    from mirror.synth.writing import write_recordings as write_recordings
    from mirror.synth.writing.secret import SECRET as SECRET
    from mirror.synth.writing.secret import read_recorded_seed as read_recorded_seed
    from mirror.synth.writing.truth import parse_truth_kinds as parse_truth_kinds

__all__ = [
    "MARK",
    "POPULATION",
    "PRESETS",
    "SECRET",
    "SKY",
    "Body",
    "CameraResponse",
    "Condition",
    "Effects",
    "Errors",
    "Instant",
    "Label",
    "Lens",
    "Model",
    "RasterizedView",
    "RenderedImage",
    "RoadUser",
    "RollingImage",
    "Scene",
    "SurfaceBuffer",
    "Surroundings",
    "SynthDrive",
    "SynthReport",
    "Truth",
    "cast_rays",
    "cut_line",
    "develop",
    "get_body",
    "instant_of",
    "make_drive",
    "make_drives",
    "make_lens",
    "parse_public_seed",
    "parse_readouts",
    "parse_truth_kinds",
    "rasterize_view",
    "read_recorded_seed",
    "street_map",
    "write_hidden_truth",
    "write_recordings",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Body": "mirror.synth.road_users.body",
        "CameraResponse": "mirror.synth.render.develop.camera_response",
        "Condition": "mirror.synth.light.condition",
        "Effects": "mirror.synth.light.condition",
        "Errors": "mirror.synth.errors",
        "Instant": "mirror.synth.render.scene",
        "Label": "mirror.synth.model",
        "Lens": "mirror.synth.render.lens",
        "MARK": "mirror.synth.roads.markings",
        "Model": "mirror.synth.model",
        "POPULATION": "mirror.synth.driving.bodies",
        "PRESETS": "mirror.synth.fleet",
        "RasterizedView": "mirror.synth.render.view",
        "RenderedImage": "mirror.synth.render.scene",
        "RoadUser": "mirror.synth.road_users.body",
        "RollingImage": "mirror.synth.render.scene",
        "SECRET": "mirror.synth.writing.secret",
        "SKY": "mirror.synth.render.coverage",
        "Scene": "mirror.synth.render.scene",
        "Surroundings": "mirror.synth.render.surroundings",
        "SurfaceBuffer": "mirror.synth.render.surfaces",
        "SynthDrive": "mirror.synth.fleet.drive",
        "SynthReport": "mirror.synth.writing",
        "Truth": "mirror.synth.truth",
        "cast_rays": "mirror.synth.truth.casting",
        "cut_line": "mirror.synth.render.lens",
        "develop": "mirror.synth.render.develop.developing",
        "get_body": "mirror.synth.driving.bodies",
        "instant_of": "mirror.synth.light.sun",
        "make_drive": "mirror.synth.fleet.drives",
        "make_drives": "mirror.synth.fleet.drives",
        "make_lens": "mirror.synth.render.lens",
        "parse_public_seed": "mirror.synth.seeds",
        "parse_readouts": "mirror.synth.rigs.readouts",
        "parse_truth_kinds": "mirror.synth.writing.truth",
        "rasterize_view": "mirror.synth.render.view",
        "read_recorded_seed": "mirror.synth.writing.secret",
        "street_map": "mirror.synth.maps",
        "write_hidden_truth": "mirror.synth.hidden_truth",
        "write_recordings": "mirror.synth.writing",
    },
)
