"""The materials of surfaces; the renderer defines the appearance of each."""

from __future__ import annotations

from enum import IntEnum


class Material(IntEnum):
    """A material of a surface of the synthetic street."""

    PLAIN = 0
    """One colour, diffuse."""
    ASPHALT = 1
    """A carriageway, with the markings of its face's layout."""
    PAVING = 2
    """Slabs with joints."""
    KERB = 3
    GRASS = 4
    GRAVEL = 5
    """Bare ground, dirt, gravel."""
    FACADE = 6
    """A wall with windows: storeys above a ground floor."""
    SHOPFRONT = 7
    """A ground floor of shop windows and doors; its face is as wide as the shop."""
    BRICK = 8
    PLASTER = 9
    CONCRETE = 10
    ROOF = 11
    """Tiles or slates."""
    WOOD = 12
    BARK = 13
    LEAVES = 14
    METAL = 15
    GLASS = 16
    """Dark glass that mirrors the sky: windows of vehicles, panes."""
    PAINT = 17
    """Glossy bodywork of one colour."""
    RUBBER = 18
    RIM = 19
    """The outer side of a wheel, about (0, 0)."""
    CLOTH = 20
    SKIN = 21
    HEADLIGHT = 22
    """White; emits light at night if the face's lights are on."""
    TAIL_LIGHT = 23
    """Red; emits light at night if the face's lights are on."""
    STREET_LAMP = 24
    """Emits light at night."""
    SIGNAL = 25
    """A lamp of a traffic light; emits light of its colour while the face's lights are on."""
    IMAGE = 26
    """An image of the catalogue, as wide and as high as its face."""
    LIT_IMAGE = 27
    """An image that emits light at night: shop signs, billboards."""
    SKYLINE = 28
    """A distant wood."""
    WATER = 29
