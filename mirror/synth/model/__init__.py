"""Geometry of the street: planar faces and ellipsoids, with materials and semantic labels."""

from __future__ import annotations

from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.pieces import Finish, Pieces
from mirror.synth.model.polygons import polygon, polygons
from mirror.synth.model.shapes import block, ellipsoid, extrusion, prism, tube, wheel
from mirror.synth.model.surfaces import FACE, NO_IMAGE, NO_OBJECT, ROUND, Model, Side, flat, merge_models

__all__ = [
    "FACE",
    "NO_IMAGE",
    "NO_OBJECT",
    "ROUND",
    "Finish",
    "Label",
    "Material",
    "Model",
    "Pieces",
    "Side",
    "block",
    "ellipsoid",
    "extrusion",
    "flat",
    "merge_models",
    "polygon",
    "polygons",
    "prism",
    "tube",
    "wheel",
]
