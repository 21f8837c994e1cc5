"""Draws billboards, posters, and the sides of vans, trucks and buses."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.portable import arrays
from mirror.synth.textures.images.drawing import (
    Box,
    Colour,
    choose_colour,
    disc,
    fill,
    gradient,
    mix,
    new_image,
    part,
    rectangle,
    rounded_rectangle,
    shade,
    star,
    stroke,
    weather,
)
from mirror.synth.textures.images.lettering import Style, write
from mirror.synth.textures.images.motifs import BRIGHT, DEEP, MOTIFS, PALE

_SLOGANS: Final = (
    ("WEITER SEHEN", "ALPENZUG - jede Stunde"), ("Die Stadt gehört dir", "URBANIA WOHNEN"),
    ("ECHT. KALT.", "Quellfrisch seit 1888"), ("LEISE ANKOMMEN", "Der neue VOLTERRA E3"),
    ("Guten Morgen!", "KAFFEE MARLO"), ("Frisch vom Feld", "BIOMARKT SONNHUT"),
    ("SPRING!", "Stadtlauf 12. Mai"), ("Kunst für alle", "MUSEUM AM WALL"),
    ("Ab ans Meer", "FERNBLICK REISEN"), ("Schlaf gut", "HOTEL ARKADIA"),
    ("-30 % AUF ALLES", "MÖBEL HOLZNER"), ("MEHR NETZ", "TELORA 6G"),
    ("DEIN BROT", "Bäckerei Mohnblatt"), ("SAFT & KRAFT", "Obsthof Lindwerd"),
    ("TANZNACHT", "Halle 7 - Freitag"), ("HALLO ZUKUNFT", "UNIONA BANK"),
)  # fmt: skip
_EVENTS: Final = (
    ("JAZZ", "IM HOF", "14. Juni"), ("FAUST", "Theater am Ring", "Premiere 3. 9."),
    ("FLOHMARKT", "Messplatz", "Sonntag"),
    ("NACHTLICHT", "Ein Film von M. Orell", "ab Donnerstag"), ("ORGEL", "Dom St. Jorun", "Eintritt frei"),
    ("WEINFEST", "Altstadt", "8.-12. August"), ("STADTLAUF", "21 km", "12. Mai"),
    ("EISDISCO", "Arena Nord", "jeden Sa"),
    ("ZIRKUS", "CORVINO", "nur bis 9. 11."), ("BÜCHERTAGE", "Lesungen", "im Mai"), ("ROCK", "AM WEHR", "3 Bühnen"),
    ("COMEDY", "Lachwerk", "20 Uhr"), ("BLÜTEN", "Gartenschau", "bis Oktober"), ("KINO", "IM PARK", "bei Dunkelheit"),
    ("YOGA", "Haus Lotos", "Probestunde"), ("CHOR", "Die Hohen Töne", "Stadthalle"),
)  # fmt: skip
_FIRMS: Final = (
    ("VOLANTIS", "Paketdienst", "volantis.example"), ("Maler Pinsler", "Meisterbetrieb", "Tel. 73 82 19"),
    ("FRISCHKOMET", "Lebensmittel nach Hause", "frischkomet.example"),
    ("Elektro Funkel", "Installation", "Tel. 55 14 62"),
    ("KRANTEC", "Hebebühnen & Gerüste", "krantec.example"), ("Bäckerei Mohnblatt", "täglich frisch", "seit 1927"),
    ("NORDFRACHT", "Spedition Lager Logistik", "nordfracht.example"), ("Sanitär Rohrmann", "Bad Heizung", "Notdienst"),
    ("AQUADOR", "Mineralwasser", "aus der Tiefe"), ("Umzüge Schulterblatt", "nah & fern", "Tel. 61 77 43"),
    ("Glaserei Klarmann", "Fenster Türen", "Tel. 32 96 58"), ("TELORA", "mehr Netz", "telora.example"),
    ("Gartenbau Wurzler", "Pflanzen Pflegen", "Tel. 84 21 36"), ("ISOTHERM EXPRESS", "gekühlte Fracht", "-24 Grad"),
    ("ARKADIA", "Hotelwäsche", "arkadia.example"), ("STEINLAUS", "Naturstein Fliesen", "Tel. 49 65 12"),
)  # fmt: skip
_PAINTS: Final[tuple[Colour, ...]] = (
    (224, 224, 222), (228, 228, 228), (214, 214, 212), (226, 226, 220), (196, 150, 30), (34, 62, 128), (150, 30, 34),
    (36, 100, 66),
)  # fmt: skip


def billboard(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw an advertisement: a motif, a slogan, a name."""
    slogan, name = _SLOGANS[turn % len(_SLOGANS)]
    image = new_image(wide, high, choose_colour(rng, PALE))
    motif = MOTIFS[turn % len(MOTIFS)]
    accent = choose_colour(rng, BRIGHT)
    layout = int(rng.integers(3))
    if layout == 0:
        motif(image, rng)
        words: Box = (0.06 * wide, 0.06 * high, 0.94 * wide, 0.30 * high)
        write(image, slogan, words, (242, 240, 234), weight=800, outline=((24, 24, 30), 2))
        rectangle(image, (0, 0.85 * high, wide, high), accent)
        write(
            image, name, (0.05 * wide, 0.875 * high, 0.95 * wide, 0.975 * high), (240, 238, 232), weight=600, align=0.95
        )
    elif layout == 1:
        motif(part(image, (0.5 * wide, 0, wide, high)), rng)
        fill(image, [(0, 0), (0.56 * wide, 0), (0.48 * wide, high), (0, high)], accent)
        half = slogan.split(" ", 1) if " " in slogan else [slogan]
        for number, line in enumerate(half):
            step = 0.30 * high
            top = 0.14 * high + number * step
            write(
                image, line, (0.04 * wide, top, 0.46 * wide, top + 0.78 * step), (242, 240, 234), weight=900, align=0.0
            )
        write(image, name, (0.04 * wide, 0.80 * high, 0.44 * wide, 0.92 * high), (242, 240, 234), weight=500, align=0.0)
    else:
        motif(part(image, (0.04 * wide, 0.06 * high, 0.96 * wide, 0.68 * high)), rng)
        ink = choose_colour(rng, DEEP)
        new = rng.random() < 0.6
        right = (0.74 if new else 0.95) * wide
        write(image, slogan, (0.05 * wide, 0.71 * high, right, 0.86 * high), ink, weight=800, align=0.0)
        write(image, name, (0.05 * wide, 0.885 * high, 0.7 * wide, 0.96 * high), accent, weight=600, align=0.0)
        if new:
            fill(image, star(0.88 * wide, 0.80 * high, 0.13 * high, 12, 0.85), accent)
            write(image, "NEU", (0.835 * wide, 0.77 * high, 0.925 * wide, 0.83 * high), (242, 240, 234), weight=800)
    weather(image, rng, 0.02)
    return image


def poster(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw a poster for an event: a motif or plain colour, large words, place and day."""
    title, place, day = _EVENTS[turn % len(_EVENTS)]
    ground, ink = (
        (choose_colour(rng, DEEP), (238, 234, 224))
        if rng.random() < 0.5
        else (choose_colour(rng, PALE), choose_colour(rng, DEEP))
    )
    accent = choose_colour(rng, BRIGHT)
    image = new_image(wide, high, ground)
    layout = int(rng.integers(3))
    if layout == 0:
        MOTIFS[(turn + 5) % len(MOTIFS)](part(image, (0, 0, wide, 0.62 * high)), rng)
        top = 0.64
    elif layout == 1:
        gradient(image, mix(ground, accent, 0.5), ground)
        for number in range(9):
            share = number / 9
            disc(image, 0.5 * wide, 0.36 * high, (0.42 - 0.045 * number) * wide, mix(accent, ground, share % 0.5 * 2))
        top = 0.66
    else:
        MOTIFS[(turn + 2) % len(MOTIFS)](part(image, (0.08 * wide, 0.28 * high, 0.92 * wide, 0.86 * high)), rng)
        top = 0.04
    write(image, title, (0.06 * wide, top * high, 0.94 * wide, (top + 0.16) * high), ink, weight=900)
    write(
        image,
        place,
        (0.08 * wide, (top + 0.18) * high, 0.92 * wide, (top + 0.235) * high),
        mix(accent, ink, 0.45),
        weight=600,
    )
    write(image, day, (0.08 * wide, 0.89 * high, 0.92 * wide, 0.96 * high), ink, weight=500)
    stroke(
        image, [(2, 2), (wide - 2, 2), (wide - 2, high - 2), (2, high - 2)], mix(ground, (255, 255, 255), 0.3), 3, True
    )
    weather(image, rng, 0.03)
    return image


def livery(rng: np.random.Generator, wide: int, high: int, turn: int) -> UInt8:
    """Draw the side of a van or a truck: its colour, stripes, a firm's name."""
    firm, trade, contact = _FIRMS[turn % len(_FIRMS)]
    ground = _PAINTS[turn % len(_PAINTS)]
    light = sum(ground) > 480
    ink = choose_colour(rng, DEEP) if light else (236, 234, 228)
    accent = BRIGHT[(turn * 3 + 1) % len(BRIGHT)]
    image = new_image(wide, high, ground)
    gradient(image, ground, shade(ground, 0.94))
    layout = int(rng.integers(4))
    if layout == 0:
        for number, tone in enumerate((accent, mix(accent, ground, 0.5))):
            a = (0.55 + 0.12 * number) * wide
            fill(image, [(a, high), (a + 0.08 * wide, high), (a + 0.30 * wide, 0), (a + 0.22 * wide, 0)], tone)
    elif layout == 1:
        x = np.linspace(0, wide, 30)
        y = (0.72 + 0.08 * arrays.sin(2.2 * np.pi * x / wide + turn)) * high
        fill(image, [*zip(x, y), (wide, high), (0, high)], accent)
    elif layout == 2:
        MOTIFS[(turn + 3) % len(MOTIFS)](part(image, (0.62 * wide, 0, wide, high)), rng)
    else:
        rounded_rectangle(image, (0.03 * wide, 0.12 * high, 0.20 * wide, 0.46 * high), 0.05 * wide, accent)
        write(image, firm[0], (0.06 * wide, 0.18 * high, 0.17 * wide, 0.40 * high), (240, 238, 232), weight=900)
    left = 0.24 if layout == 3 else 0.05
    right = 0.58 if layout == 2 else 0.95
    style: Style = "italic" if rng.random() < 0.4 else "sans"
    write(image, firm, (left * wide, 0.12 * high, right * wide, 0.44 * high), ink, weight=800, align=0.0, style=style)
    write(
        image,
        trade,
        (left * wide, 0.50 * high, right * wide, 0.62 * high),
        mix(ink, ground, 0.2),
        weight=500,
        align=0.0,
    )
    tone = (238, 236, 230) if layout == 1 else ink
    write(image, contact, (0.05 * wide, 0.82 * high, 0.55 * wide, 0.92 * high), tone, weight=500, align=0.0)
    weather(image, rng, 0.02)
    return image
