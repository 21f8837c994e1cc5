"""What things are built of: planar faces and ellipsoids, with materials and labels."""

from __future__ import annotations

from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.shapes import block, ellipsoid, extrusion, polygon, polygons, prism, tube, wheel
from mirror.synth.model.surfaces import FACE, NO_IMAGE, NO_OBJECT, ROUND, Model, Side, merged

__all__ = [
    "FACE",
    "NO_IMAGE",
    "NO_OBJECT",
    "ROUND",
    "Label",
    "Material",
    "Model",
    "Side",
    "block",
    "ellipsoid",
    "extrusion",
    "merged",
    "polygon",
    "polygons",
    "prism",
    "tube",
    "wheel",
]
