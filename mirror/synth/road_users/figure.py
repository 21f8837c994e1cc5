"""Builds the model of a person from a skeleton and clothes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.model import NO_IMAGE, Label, Material, Model, merge_models, polygons
from mirror.synth.model.batches import ellipsoids
from mirror.synth.road_users.skeleton import Skeleton, head_half_m
from mirror.synth.textures.faces import HEAD_ASPECT, draw_features

Colour = tuple[float, float, float]
Garment = Literal["shirt", "jacket", "coat", "dress"]
Hat = Literal["none", "beanie", "cap", "cycle helmet", "full helmet"]
Bag = Literal["none", "backpack", "handbag"]

_HEMS: Final[dict[Garment, tuple[float, float]]] = {
    "shirt": (-0.015, 1.22),
    "jacket": (-0.05, 1.32),
    "coat": (-0.17, 1.58),
    "dress": (-0.21, 1.68),
}
"""Height of the hem above the hips as a share of the trunk's height; its width as a share of the waist's."""
_NEXT: Final = np.array([1, 2, 0])
_AFTER: Final = np.array([2, 0, 1])
_BLACK: Final = (0.02, 0.02, 0.022)


@dataclass(frozen=True)
class Person:
    """Body and clothes of a person.

    Attributes:
        height_m: height when standing, without a hat.
        stout: width of trunk and limbs, relative to the average of 1.
        face: index of the face in the catalogue.
        garment: garment on the trunk; shirts leave the forearms bare, dresses the legs.
        top: colour of the garment.
        legs: colour of the trousers.
        shoes: colour of the shoes.
        hat: kind of hat.
        hat_colour: colour of the hat.
        bag: kind of bag.
        bag_colour: colour of the bag.
        umbrella: colour of a raised umbrella, or None.
        seed: seed of the cloth's texture.
    """

    height_m: float
    stout: float
    face: int
    garment: Garment
    top: Colour
    legs: Colour
    shoes: Colour
    hat: Hat
    hat_colour: Colour
    bag: Bag
    bag_colour: Colour
    umbrella: Colour | None
    seed: int


class _EllipsoidList:
    """Collects ellipsoids; all limbs are oriented in one vectorised step."""

    def __init__(self) -> None:
        self.rows: list[tuple[Float64, tuple[float, float, float], Float64, Colour, Material, int]] = []
        self.limbs: list[tuple[Float64, Float64, float, Colour, Material, float]] = []

    def add(
        self, centre: Float64, half: tuple[float, float, float], axes: Float64, colour: Colour,
        material: Material = Material.CLOTH, image: int = NO_IMAGE,
    ) -> None:  # fmt: skip
        self.rows.append((centre, half, axes, colour, material, image))

    def limb(
        self, start: Float64, end: Float64, radius: float, colour: Colour, material: Material = Material.CLOTH,
        over: float = 1.22,
    ) -> None:  # fmt: skip
        """Add a limb from joint to joint, longer than their distance by the factor ``over``."""
        self.limbs.append((start, end, radius, colour, material, over))

    def model(self, label: Label, seed: int) -> Model:
        centres, halves, axes, colours, materials, images = zip(*self.rows)
        starts, ends, radii, limb_colours, limb_materials, over = zip(*self.limbs)
        way = np.array(ends) - np.array(starts)
        length = np.linalg.norm(way, axis=1)
        around = np.array(radii)
        return ellipsoids(
            np.concatenate([centres, 0.5 * (np.array(ends) + np.array(starts))]),
            np.concatenate([halves, np.stack([around, around, 0.5 * np.array(over) * length], axis=1)]),
            np.concatenate([colours, limb_colours]),
            np.concatenate([materials, limb_materials]),
            label,
            axes=np.concatenate([axes, _axes_along(way / length[:, None])]),
            images=np.concatenate([images, np.full(len(starts), NO_IMAGE)]),
            seeds=seed,
        )


def _cross_products(first: Float64, second: Float64) -> Float64:
    """Cross products of (..., 3) vectors; `numpy.cross` is much slower for a few vectors."""
    return first[..., _NEXT] * second[..., _AFTER] - first[..., _AFTER] * second[..., _NEXT]


def _axes_along(way: Float64) -> Float64:
    """Axes (N, 3, 3) as rows; the third is along each direction (N, 3)."""
    second = np.where(np.abs(way[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, -1.0]])
    side = _cross_products(way, second)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.stack([_cross_products(side, way), side, way], axis=1)


def build_person(person: Person, skeleton: Skeleton, label: Label) -> Model:
    """Build the model of a person in a pose.

    Args:
        person: body and clothes.
        skeleton: the pose, in the model's frame.
        label: PERSON or RIDER.
    """
    rounds = _EllipsoidList()
    _add_head(rounds, person, skeleton)
    _add_trunk(rounds, person, skeleton)
    _add_limbs(rounds, person, skeleton)
    if person.umbrella is not None:
        rounds.limb(skeleton.wrists[0], _umbrella_position(person, skeleton), 0.010, _BLACK, Material.METAL, 1.0)
    parts = [rounds.model(label, person.seed), _hem_model(person, skeleton, label)]
    if person.hat == "cap":
        parts.append(_brim_model(person, skeleton, label))
    if person.bag == "handbag":
        parts.append(_handbag_model(person, skeleton, label))
    if person.umbrella is not None:
        parts.append(_umbrella_model(person, person.umbrella, skeleton, label))
    return merge_models(parts)


def _add_head(rounds: _EllipsoidList, person: Person, skeleton: Skeleton) -> None:
    """Add skull, hair, ears, nose and hat; lengths are in half heights of the head."""
    half, look = head_half_m(person.height_m), draw_features(person.face)
    cos, sin = scalars.cos(skeleton.nod), scalars.sin(skeleton.nod)
    axes = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])

    def part(
        x: float, y: float, z: float, size: tuple[float, float, float], colour: Colour,
        material: Material = Material.CLOTH, image: int = NO_IMAGE,
    ) -> None:  # fmt: skip
        centre = skeleton.head + half * (arrays.matmul(np.array([x, y, z]), axes))
        rounds.add(centre, (half * size[0], half * size[1], half * size[2]), axes, colour, material, image)

    rounds.limb(skeleton.neck - [0.0, 0.0, 0.01], skeleton.head - half * axes[2] * 0.55, 0.46 * half, look.skin,
                Material.SKIN)  # fmt: skip
    if person.hat == "full helmet":
        part(0.0, 0.0, 0.05, (1.16, 0.95, 1.14), person.hat_colour, Material.PAINT)
        part(0.26, 0.0, 0.08, (0.95, 0.86, 0.42), _BLACK, Material.GLASS)
        return
    part(0.0, 0.0, 0.0, (0.84, HEAD_ASPECT, 1.0), look.skin, Material.SKIN, person.face)
    part(0.70, 0.0, -0.25, (0.30, 0.13, 0.20), look.skin, Material.SKIN)
    if look.style in ("short", "parted", "bun", "bald"):
        for y in (0.69, -0.69):
            part(-0.05, y, -0.08, (0.17, 0.09, 0.28), look.skin, Material.SKIN)
    if look.style != "bald":
        part(-0.22, 0.0, 0.17, (0.80, 0.75, 0.93), look.hair)
    if look.style in ("long", "fringe"):
        low, length = (-0.55, 1.20) if look.style == "long" else (-0.30, 0.90)
        part(-0.40, 0.0, low, (0.46, 0.76, length), look.hair)
    if look.style == "bun":
        part(-0.95, 0.0, 0.45, (0.33, 0.36, 0.33), look.hair)
    if person.hat in ("beanie", "cap"):
        part(-0.10, 0.0, 0.66, (0.88, 0.82, 0.56), person.hat_colour)
    if person.hat == "cycle helmet":
        part(-0.08, 0.0, 0.72, (1.10, 0.88, 0.58), person.hat_colour, Material.PAINT)


def _add_trunk(rounds: _EllipsoidList, person: Person, skeleton: Skeleton) -> None:
    """Add chest, belly, pelvis, shoulders and a backpack."""
    middle, chest = skeleton.hips.mean(axis=0), skeleton.shoulders.mean(axis=0)
    axes = _trunk_axes(skeleton)
    size, wide = person.height_m, person.height_m * person.stout
    shoulder_line = skeleton.shoulders[0] - skeleton.shoulders[1]
    shoulder_line = shoulder_line / arrays.norm(shoulder_line)
    below = person.top if person.garment in ("coat", "dress") else person.legs
    bulk = 1.0 if person.garment == "shirt" else 1.08
    way = chest - middle
    rounds.add(middle + 0.02 * way, (0.064 * wide, 0.094 * wide, 0.078 * size), axes, below)
    rounds.add(middle + 0.36 * way, (0.062 * wide * bulk, 0.090 * wide * bulk, 0.125 * size), axes, person.top)
    turned = np.array([_cross_products(shoulder_line, axes[2]), shoulder_line, axes[2]])
    rounds.add(middle + 0.70 * way, (0.068 * wide * bulk, 0.106 * wide * bulk, 0.130 * size), turned, person.top)
    rounds.add(chest - 0.02 * way, (0.046 * wide, 0.128 * wide, 0.040 * size), turned, person.top)
    if person.garment in ("jacket", "coat"):
        collar = 0.5 * (chest + skeleton.neck) + [0.0, 0.0, 0.012 * size]
        rounds.add(collar, (0.043 * size, 0.045 * size, 0.026 * size), axes, person.top)
    if person.bag == "backpack":
        behind = middle + 0.66 * way - 0.115 * wide * axes[0]
        rounds.add(behind, (0.062 * size, 0.088 * size, 0.135 * size), axes, person.bag_colour)


def _trunk_axes(skeleton: Skeleton) -> Float64:
    up = skeleton.shoulders.mean(axis=0) - skeleton.hips.mean(axis=0)
    up = up / arrays.norm(up)
    return np.array([[up[2], 0.0, -up[0]], [0.0, 1.0, 0.0], up])


def _add_limbs(rounds: _EllipsoidList, person: Person, skeleton: Skeleton) -> None:
    skin, size, wide = draw_features(person.face).skin, person.height_m, person.height_m * person.stout
    sleeve = (skin, Material.SKIN) if person.garment in ("shirt", "dress") else (person.top, Material.CLOTH)
    calf = (skin, Material.SKIN) if person.garment == "dress" else (person.legs, Material.CLOTH)
    ways = skeleton.wrists - skeleton.elbows
    ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    palms = _axes_along(ways)
    ahead = skeleton.soles / np.linalg.norm(skeleton.soles, axis=1, keepdims=True)
    aside = ahead[:, [1, 0, 2]] * (-1.0, 1.0, 0.0)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    shoes = np.stack([ahead, aside, _cross_products(ahead, aside)], axis=1)
    for side in (0, 1):
        knee, ankle = skeleton.knees[side], skeleton.ankles[side]
        elbow, wrist = skeleton.elbows[side], skeleton.wrists[side]
        rounds.limb(skeleton.hips[side], knee, 0.049 * wide, person.legs)
        rounds.limb(knee, ankle, 0.034 * wide, calf[0], calf[1])
        if person.garment != "dress":
            rounds.limb(0.45 * knee + 0.55 * ankle, 0.06 * knee + 0.94 * ankle, 0.030 * wide, person.legs, over=1.5)
        rounds.limb(skeleton.shoulders[side], elbow, 0.031 * wide, person.top)
        rounds.limb(elbow, wrist, 0.025 * wide, sleeve[0], sleeve[1])
        hand = wrist + 0.035 * size * ways[side]
        rounds.add(hand, (0.024 * size, 0.014 * size, 0.046 * size), palms[side], skin, Material.SKIN)
        foot = ankle + size * (0.036 * shoes[side, 0] - 0.013 * shoes[side, 2])
        rounds.add(foot, (0.078 * size, 0.029 * size, 0.028 * size), shoes[side], person.shoes)


def _hem_model(person: Person, skeleton: Skeleton, label: Label) -> Model:
    """The part of the garment that hangs from the waist."""
    axes, size, wide = _trunk_axes(skeleton), person.height_m, person.height_m * person.stout
    middle = skeleton.hips.mean(axis=0)
    low, flare = _HEMS[person.garment]
    angle = 2.0 * math.pi * (np.arange(9) + 0.5) / 8
    ring = 0.061 * wide * arrays.cos(angle)[:, None] * axes[0] + 0.089 * wide * arrays.sin(angle)[:, None] * axes[1]
    top, foot = middle + 0.11 * size * axes[2] + ring, middle + low * size * axes[2] + flare * ring
    quads = np.stack([foot[:-1], foot[1:], top[1:], top[:-1]], axis=1)
    return polygons(quads, person.top, Material.CLOTH, label, seeds=person.seed, two_sided=True)


def _brim_model(person: Person, skeleton: Skeleton, label: Label) -> Model:
    half = head_half_m(person.height_m)
    outline = np.array([[0.62, -0.6, 0.62], [1.25, -0.4, 0.50], [1.25, 0.4, 0.50], [0.62, 0.6, 0.62]])
    return polygons(
        (skeleton.head + half * outline)[None], person.hat_colour, Material.CLOTH, label, seeds=person.seed,
        two_sided=True,
    )  # fmt: skip


def _handbag_model(person: Person, skeleton: Skeleton, label: Label) -> Model:
    """Two leaning sheets and two ends, hanging from the right hand."""
    hand = skeleton.wrists[1] - [0.0, 0.0, 0.07 * person.height_m]
    around = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    foot = hand + around * (0.17, 0.06, 0.0) - (0.0, 0.0, 0.34)
    top = hand + around * (0.17, 0.03, 0.0) - (0.0, 0.0, 0.04)
    quads = np.stack([foot, np.roll(foot, -1, axis=0), np.roll(top, -1, axis=0), top], axis=1)
    return polygons(quads, person.bag_colour, Material.CLOTH, label, seeds=person.seed, two_sided=True)


def _umbrella_model(person: Person, colour: Colour, skeleton: Skeleton, label: Label) -> Model:
    """An umbrella of eight panels."""
    apex = _umbrella_position(person, skeleton)
    angle = 2.0 * math.pi * np.arange(9) / 8
    rim = apex + np.c_[0.48 * arrays.cos(angle), 0.48 * arrays.sin(angle), np.full(9, -0.24)]
    panels = np.stack([rim[:-1], rim[1:], np.broadcast_to(apex, (8, 3))], axis=1)
    return polygons(panels, colour, Material.CLOTH, label, seeds=person.seed, two_sided=True)


def _umbrella_position(person: Person, skeleton: Skeleton) -> Float64:
    """Position of the umbrella's top: above the left hand, shifted a little towards the head."""
    hand = skeleton.wrists[0]
    return np.array([hand[0] + 0.05, 0.6 * hand[1], person.height_m + 0.30])
