"""What surfaces are made of: how each is shaded is the renderer's to know."""

from __future__ import annotations

from enum import IntEnum


class Material(IntEnum):
    """Material of a surface."""

    PLAIN = 0
    """One colour, dull."""
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
    """White; burns at night where the face's lights are on."""
    TAIL_LIGHT = 23
    """Red; burns at night where the face's lights are on."""
    STREET_LAMP = 24
    """Burns at night."""
    SIGNAL = 25
    """A lamp of a traffic light, that burns in its own colour while its face's lights are on."""
    IMAGE = 26
    """An image out of the catalogue, as wide and as high as its face."""
    LIT_IMAGE = 27
    """An image that shines at night: shop signs, billboards."""
    SKYLINE = 28
    """A far house or wood: windows as a pattern."""
    WATER = 29
