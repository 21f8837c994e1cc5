"""Draws the signs of shops."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.portable import arrays
from mirror.synth.textures.images.drawing import (
    Colour,
    choose_colour,
    disc,
    fill,
    gradient,
    mix,
    new_image,
    rectangle,
    rounded_rectangle,
    shade,
    star,
    stroke,
    weather,
)
from mirror.synth.textures.images.lettering import Style, write
from mirror.synth.textures.images.motifs import BRIGHT, DEEP, PALE

_NAMES: Final = (
    ("Bäckerei Mohnblatt", "seit 1927"), ("CAFÉ LARIMAR", "Kaffee & Kuchen"), ("Optik Sehfein", "Brillen"),
    ("Apotheke am Tor", "Mo-Sa 8-19"), ("Blumen Irmela", "Floristik"), ("RAD KOLBERT", "Verkauf Service"),
    ("Salon Elvira", "Damen Herren"), ("TRATTORIA BELLONE", "Pizza Pasta Vino"), ("Pho Minh Sao", "Suppen Bowls"),
    ("KIOSK 24", "Getränke Tabak"), ("Buchhandlung Satzbau", "Bücher"), ("Juwelier Aurin", "Gold Uhren"),
    ("VELARIS", "mode"), ("Schuhwerk Tann", "Schuhe nach Maß"), ("SPORT NORDKAMM", "Outdoor Ski Rad"),
    ("Elektro Funkel", "Licht & Strom"), ("Möbel Holzner", "Wohnen"), ("Reisewelt Fernblick", "Urlaub Kreuzfahrt"),
    ("BURGERBUDE", "grill & fries"), ("Sushi Tamaki", "Take away"), ("Kebap Anadol", "frisch vom Grill"),
    ("Eiscafé Dolomia", "Gelato"), ("Metzgerei Haberlind", "eigene Schlachtung"), ("Weinhaus Rebgold", "Weine Sekt"),
    ("青松茶馆", "TEEHAUS"), ("Drogerie Lavendia", "Pflege Parfum"), ("SPIELKREISEL", "Spielwaren"),
    ("老街面馆", "NUDELN & MEHR"), ("Copyshop Tintenfass", "Druck Scan"), ("Waschsalon Blubb", "SB 6-23 Uhr"),
    ("Hörzentrum Klangfein", "Hörgeräte"), ("KRAFTRAUM", "Fitness Sauna"), ("TABAK & PRESSE", "Lotto Post"),
    ("Goldschmiede Ahorn", "Trauringe"), ("Biomarkt Sonnhut", "Obst Gemüse Brot"), ("UNIONA BANK", "Geldautomat"),
    ("NAGELSTUDIO PERLA", "Beauty"), ("Tierladen Pfote", "Futter Zubehör"), ("Antiquariat Staubfein", "Ankauf"),
    ("MERKANT MARKT", "Lebensmittel"),
)  # fmt: skip
_INKS: Final[tuple[Colour, ...]] = ((34, 34, 38), (30, 44, 92), (120, 26, 30), (24, 78, 48), (88, 52, 24))


def shop_sign(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw a shop sign: the name of a shop on a board."""
    name, trade = _NAMES[turn % len(_NAMES)]
    chinese = ord(name[0]) > 0x2E80
    style: Style = "uni" if chinese else "italic" if rng.random() < 0.25 else "sans"
    weight = int(rng.choice([400, 500, 700, 900]))
    layout = int(rng.choice(5, p=(0.22, 0.30, 0.22, 0.10, 0.16)))
    ground, ink = _board(rng, layout)
    image = new_image(wide, high, ground)
    gradient(image, mix(ground, (255, 255, 255), 0.06), shade(ground, 0.9))
    if layout == 3:
        for y in np.arange(0, high, high / 4):
            rectangle(image, (0, y, wide, y + 2), shade(ground, 0.6))
    if layout == 4:
        rectangle(image, (0, 0.80 * high, wide, high), ink)
    edge = shade(ground, 0.72) if layout != 0 else ink
    stroke(image, [(4, 4), (wide - 4, 4), (wide - 4, high - 4), (4, high - 4)], edge, 4, closed=True)
    left, right = 0.04 * wide, 0.96 * wide
    if rng.random() < 0.55:
        _logo(image, rng, 0.09 * wide, 0.46 * high, 0.32 * high, ink, ground, name[0])
        left = 0.18 * wide
    low = 0.72 if layout == 4 or rng.random() < 0.7 else 0.9
    glowing = layout == 2
    outline = (mix(ground, ink, 0.45), 3) if glowing else None
    write(image, name, (left, 0.12 * high, right, low * high), ink, style=style, weight=weight, outline=outline)
    if low < 0.8:
        tone = ground if layout == 4 else mix(ink, ground, 0.25)
        box = (left, 0.815 * high, right, 0.945 * high) if layout == 4 else (left, 0.77 * high, right, 0.92 * high)
        write(image, trade, box, tone, weight=500, align=float(rng.choice([0.0, 0.5, 1.0])))
    weather(image, rng, 0.035)
    return image


def _board(rng: np.random.Generator, layout: int) -> tuple[Colour, Colour]:
    """Colours of the board and of the letters."""
    if layout in (0, 4):
        ground = shade(choose_colour(rng, PALE), rng.uniform(0.82, 1.0))
        return ground, choose_colour(rng, _INKS)
    if layout == 1:
        return choose_colour(rng, BRIGHT), (236, 232, 222)
    if layout == 2:
        return shade(choose_colour(rng, DEEP), 0.8), mix(choose_colour(rng, BRIGHT), (255, 250, 235), 0.45)
    return (104, 72, 46), (234, 220, 186)


def _logo(
    image: UInt8, rng: np.random.Generator, x: float, y: float, r: float, ink: Colour, ground: Colour, first: str
) -> None:
    kind = int(rng.integers(5))
    if kind == 0:
        disc(image, x, y, r, ink)
        style: Style = "uni" if ord(first) > 0x2E80 else "sans"
        write(image, first, (x - 0.5 * r, y - 0.55 * r, x + 0.5 * r, y + 0.55 * r), ground, weight=700, style=style)
    elif kind == 1:
        fill(image, star(x, y, r, int(rng.integers(5, 9)), rng.uniform(0.4, 0.8)), ink)
    elif kind == 2:
        bend = np.linspace(0, 1, 12)
        leaf = np.c_[2 * bend - 1, 0.6 * arrays.sin(np.pi * arrays.power(bend, 0.8))]
        fill(image, np.r_[leaf, leaf[::-1] * (1, -1)] * r + (x, y), ink)
        stroke(image, [(x - r, y), (x + 0.8 * r, y)], ground, 0.08 * r)
    elif kind == 3:
        rounded_rectangle(image, (x - r, y - r, x + r, y + r), 0.3 * r, ink)
        disc(image, x, y, 0.6 * r, ground)
        disc(image, x + 0.25 * r, y - 0.2 * r, 0.5 * r, ink)
    else:
        for share in (1.0, 0.66, 0.33):
            turn = np.linspace(np.pi, 2 * np.pi, 16)
            stroke(
                image,
                np.c_[x + share * r * arrays.cos(turn), y + 0.5 * r + 1.3 * share * r * arrays.sin(turn)],
                ink,
                0.14 * r,
            )
