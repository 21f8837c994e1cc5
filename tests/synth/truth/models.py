"""Simple models."""

from mirror.synth.model import Label, Material, Model, ellipsoid, polygon

GREY = (0.5, 0.5, 0.5)


def square(size_m: float = 2.0, z: float = 0.0, **how: bool) -> Model:
    h = 0.5 * size_m
    return polygon([(-h, -h, z), (h, -h, z), (h, h, z), (-h, h, z)], GREY, Material.PLAIN, Label.ROAD, **how)


def ball(centre: tuple[float, float, float], radius_m: float) -> Model:
    return ellipsoid(centre, (2 * radius_m,) * 3, GREY, Material.PLAIN, Label.TERRAIN)
