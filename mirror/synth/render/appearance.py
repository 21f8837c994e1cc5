"""The appearance of materials: reflectance, emission and gloss at a surface point, averaged over a footprint."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Int64, Records, UInt8
from mirror.compiled import inner_per_pixel
from mirror.synth.model import Material
from mirror.synth.textures.catalogue import Grain
from mirror.synth.textures.sampling import grain_at, image_at

Appearance = tuple[float, float, float, float, float, float, float]
"""Reflectance in red, green and blue; emission in red, green and blue; specular reflectance at normal incidence."""

_NONE: Final = -1
_KINDS: Final = len(Material)

_GRAIN: Final = np.full(_KINDS, _NONE, np.int64)
for _material, _grain in {
    Material.ASPHALT: Grain.ASPHALT,
    Material.PAVING: Grain.PAVING,
    Material.KERB: Grain.CONCRETE,
    Material.GRASS: Grain.GRASS,
    Material.GRAVEL: Grain.GRAVEL,
    Material.BRICK: Grain.BRICK,
    Material.PLASTER: Grain.PLASTER,
    Material.CONCRETE: Grain.CONCRETE,
    Material.ROOF: Grain.ROOF,
    Material.WOOD: Grain.WOOD,
    Material.BARK: Grain.BARK,
    Material.LEAVES: Grain.LEAVES,
    Material.CLOTH: Grain.CLOTH,
    Material.METAL: Grain.METAL,
}.items():
    _GRAIN[_material] = _grain

_STAINED: Final = np.zeros(_KINDS, np.bool_)
_STAINED[[Material.ASPHALT, Material.PAVING, Material.KERB, Material.GRASS, Material.GRAVEL, Material.BRICK]] = True
_STAINED[[Material.PLASTER, Material.CONCRETE, Material.ROOF]] = True

_GLOSS: Final = np.zeros(_KINDS)
_GLOSS[[Material.METAL, Material.PAINT, Material.GLASS, Material.RIM, Material.RUBBER]] = 0.03, 0.05, 0.10, 0.05, 0.01
_GLOSS[[Material.HEADLIGHT, Material.TAIL_LIGHT, Material.WATER]] = 0.08, 0.08, 0.05

# Emission of a lit image in the dark, as a share of its reflectance.
_SHINE: Final = 1.1


@inner_per_pixel()
def plain_surface(
    grains: Float32,
    grain_index: Float64,
    material: int,
    seed: int,
    colour: tuple[float, float, float],
    u: float,
    v: float,
    u1: float,
    v1: float,
    u2: float,
    v2: float,
) -> Appearance:
    """Evaluate a surface with one colour and a grain."""
    tone = 1.0
    grain = _GRAIN[material]
    # The seed shifts the grain, so that neighbouring surfaces differ.
    shift = float(seed & 1023)
    if grain >= 0:
        tone = grain_at(grains, grain_index, grain, u + 0.37 * shift, v + 0.73 * shift, u1, v1, u2, v2)
    if _STAINED[material]:
        tone *= grain_at(grains, grain_index, Grain.STAINS.value, u + 1.7 * shift, v, u1, v1, u2, v2)
    return colour[0] * tone, colour[1] * tone, colour[2] * tone, 0.0, 0.0, 0.0, _GLOSS[material]


@inner_per_pixel()
def image_surface(
    images: UInt8,
    image_index: Int64,
    face: Records,
    u: float,
    v: float,
    u1: float,
    v1: float,
    u2: float,
    v2: float,
    setting: Records,
) -> Appearance:
    """Evaluate a face that an image of the catalogue fills."""
    wide, high = 0.5 / face.half_0, 0.5 / face.half_1
    r, g, b = image_at(
        images, image_index, face.image, 0.5 + u * wide, 0.5 + v * high, u1 * wide, v1 * high, u2 * wide, v2 * high
    )
    shine = _SHINE * setting.lit_windows if face.material == Material.LIT_IMAGE else 0.0
    return r, g, b, shine * r, shine * g, shine * b, 0.02


@inner_per_pixel()
def lamp_surface(face: Records, setting: Records) -> Appearance:
    """Evaluate the face of a street lamp or a traffic light."""
    r, g, b = face.colour_0, face.colour_1, face.colour_2
    if face.material == Material.STREET_LAMP:
        return r, g, b, 6.0 * setting.lamp_light_0, 6.0 * setting.lamp_light_1, 6.0 * setting.lamp_light_2, 0.0
    glow = float(face.lights) * (1.6 + 0.6 * setting.dark)
    return 0.12 * r, 0.12 * g, 0.12 * b, glow * r, glow * g, glow * b, 0.02
