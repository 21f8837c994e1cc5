"""Tests of images: readable plates, sign colours, words that fit their box."""

import re

import cv2
import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.synth.textures.catalogue import PLATES, TRAFFIC_SIGNS, Sign
from mirror.synth.textures.images import draw_image
from mirror.synth.textures.images.drawing import glow, new_image, rounded_rectangle, weather
from mirror.synth.textures.images.lettering import glyph, letter, write
from mirror.synth.textures.images.plates import plate_image, plate_text

CHARACTERS = "ABCDEFGHJKLMNPRSTUVWXYZ0123456789"


def test_plates_differ_and_have_valid_texts() -> None:
    texts = [plate_text(number) for number in PLATES]
    assert len(set(texts)) == len(texts) == 256
    assert all(re.fullmatch(r"[A-HJ-NPR-Z]{2} [A-HJ-NPR-Z]{2} \d{3}", text) for text in texts)
    for other in (PLATES.start - 1, PLATES.stop):
        with pytest.raises(UsageError):
            plate_text(other)
        with pytest.raises(UsageError):
            plate_image(other)


def stamp(sign: str) -> np.ndarray:
    """Template of a character, in another size than on the plate."""
    image = new_image(60, 100, (226, 226, 221))
    letter(image, sign, (0, 0, 60 if sign.isalpha() else 57, 100), (26, 26, 28), 13)
    return cv2.resize(image, (24, 40), interpolation=cv2.INTER_AREA)[..., 0].astype(np.float32)


def read(image: np.ndarray) -> str:
    """Read the characters from connected dark components and the nearest template."""
    grey = cv2.resize(image, (520, 110), interpolation=cv2.INTER_CUBIC)[..., 0]
    _, _, stats, _ = cv2.connectedComponentsWithStats((grey < 120).astype(np.uint8))
    boxes = [box for box in stats[1:].tolist() if 55 < box[3] < 90 and box[2] < 60 and box[0] > 48]
    templates = {}
    for sign in CHARACTERS:
        inner = stamp(sign)
        columns, rows = np.flatnonzero((inner < 120).any(axis=0)), np.flatnonzero((inner < 120).any(axis=1))
        cut = inner[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        templates[sign] = (cut.shape[1] / cut.shape[0], cv2.resize(cut, (20, 32)))
    found = ""
    for x, y, wide, high, _ in sorted(boxes):
        piece = cv2.resize(grey[y : y + high, x : x + wide].astype(np.float32), (20, 32))
        found += min(
            templates,
            key=lambda sign: np.abs(templates[sign][1] - piece).mean() + 120 * abs(templates[sign][0] - wide / high),
        )
    return found


@pytest.mark.parametrize("wide", [256, 208, 130])
def test_plates_can_be_read(wide: int) -> None:
    right = total = 0
    for number in PLATES[::16]:
        text = plate_text(number).replace(" ", "")
        full = plate_image(number)
        small = cv2.resize(full, (wide, round(wide * 11 / 52)), interpolation=cv2.INTER_AREA)
        found = read(small)
        right += sum(a == b for a, b in zip(found, text)) if len(found) == len(text) else 0
        total += len(text)
    assert right >= 0.97 * total


def test_plates_are_white_with_a_blue_band() -> None:
    image = plate_image(PLATES[5]).astype(int)
    band = image[8:56, 4:20].reshape(-1, 3).mean(axis=0)
    assert band[2] > band[0] + 50
    assert np.median(image[:, 24:], axis=(0, 1)).min() > 200


def test_signs_have_their_colours() -> None:
    def colour(sign: Sign, x: float, y: float) -> np.ndarray:
        image = draw_image(int(sign)).astype(int)
        return image[int(y * 127), int(x * 127)]

    assert list(range(Sign.SPEED_30, Sign.ROUNDABOUT + 1)) == list(TRAFFIC_SIGNS)
    for sign in (Sign.SPEED_30, Sign.NO_ENTRY, Sign.NO_PARKING, Sign.STOP):
        red = colour(sign, 0.5, 0.055)
        assert red[0] > 2 * red[1] and red[0] > 2 * red[2]
    for sign in (Sign.PARKING, Sign.CROSSWALK, Sign.ONE_WAY, Sign.KEEP_RIGHT, Sign.ROUNDABOUT, Sign.CYCLE_PATH):
        blue = colour(sign, 0.5, 0.1)
        assert blue[2] > 1.8 * blue[0]
    assert colour(Sign.YIELD, 0.5, 0.4).min() > 200
    yellow = colour(Sign.PRIORITY, 0.5, 0.5)
    assert yellow[:2].min() > 150 and yellow[2] < 80


@pytest.mark.parametrize("words", ["A", "Bäckerei Mohnblatt", "-30 %", "青松茶馆"])
@pytest.mark.parametrize("box", [(10, 10, 290, 90), (10, 40, 290, 60), (100, 10, 140, 90)])
def test_words_stay_within_their_box(words: str, box: tuple[int, int, int, int]) -> None:
    image = new_image(300, 100, (0, 0, 0))
    write(image, words, box, (255, 255, 255), weight=700, style="uni" if ord(words[0]) > 999 else "sans")
    rows, columns = np.flatnonzero(image.any(axis=(1, 2))), np.flatnonzero(image.any(axis=(0, 2)))
    assert len(rows) > 0
    left, top, right, bottom = box
    assert columns[0] >= left - 2 and columns[-1] <= right + 2
    assert rows[0] >= top - 2 and rows[-1] <= bottom + 2
    assert columns[-1] - columns[0] > 0.6 * (right - left) or rows[-1] - rows[0] > 0.6 * (bottom - top)


def test_letters_fill_their_box() -> None:
    for sign in CHARACTERS:
        lines = np.concatenate(glyph(sign, 0.6))
        assert lines.min() > -0.05 and lines[:, 0].max() < 0.65 and lines[:, 1].max() < 1.05
        assert np.ptp(lines[:, 1]) > 0.9
        image = new_image(60, 100, (255, 255, 255))
        letter(image, sign, (5, 5, 55, 95), (0, 0, 0), 10)
        dark = np.flatnonzero((image < 128).any(axis=(1, 2)))
        assert abs(dark[0] - 5) <= 3 and abs(dark[-1] - 94) <= 3


def test_drawing_at_the_edges_stays_in_range() -> None:
    image = new_image(40, 30, (10, 20, 30))
    rounded_rectangle(image, (5, 5, 5, 5), 8, (200, 0, 0))
    glow(image, -100.0, 50.0, 5.0, 1.0)
    glow(image, 0.0, 0.0, 20.0, 1.0)
    assert image[0, 0].min() > 150 and (image[29, 39] == (10, 20, 30)).all()
    white = new_image(40, 30, (255, 255, 255))
    weather(white, np.random.default_rng(0), 0.5)
    assert white.max() == 255
