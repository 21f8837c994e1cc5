"""The chart of a street's training: PSNR and number of Gaussians over processor time, as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hybridworldsim.training.run.curves import Row
from mirror.schema.files import write_bytes

_COLOURS: Final = ("#1f6fb4", "#c8502a")


def write_chart(path: Path, rows: Sequence[Row], title: str) -> None:
    """Write PSNR and number of Gaussians over processor time as SVG; nothing without rows."""
    if not rows:
        return
    minutes = [row["core_s"] / 60.0 for row in rows]
    lines = "".join(
        _line(minutes, [row[name] for row in rows], colour, place, label)
        for name, colour, place, label in (
            ("psnr_db", _COLOURS[0], 0, "PSNR of training images, dB"),
            ("gaussians", _COLOURS[1], 1, "Gaussians"),
        )
    )
    text = f'<text x="16" y="22" font-size="14">{_escaped(title)}</text>'
    frame = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 420" font-family="sans-serif">'
    write_bytes(path, f'{frame}<rect width="640" height="420" fill="white"/>{text}{lines}</svg>\n'.encode())


def _line(x: Sequence[float], y: Sequence[float], colour: str, place: int, label: str) -> str:
    top, height, left, width = 48 + 186 * place, 130, 70, 540
    ticks = _round_ticks(min(y), max(y))
    low, high, x_max = ticks[0], ticks[-1], max(x) or 1.0

    def y_px(value: float) -> float:
        return top + height * (high - value) / (high - low)

    points = " ".join(f"{left + width * a / x_max:.1f},{y_px(b):.1f}" for a, b in zip(x, y))
    labels = [
        (left, top - 8.0, "start", label),
        (left, top + height + 16.0, "start", "0"),
        (left + width, top + height + 16.0, "end", f"{max(x):.3g} core-minutes"),
        *((left - 6, y_px(tick) + 4.0, "end", f"{tick:,g}") for tick in ticks),
    ]
    texts = "".join(
        f'<text x="{a}" y="{b:.1f}" font-size="11" text-anchor="{side}">{_escaped(label_text)}</text>'
        for a, b, side, label_text in labels
    )
    lines = "".join(f'<path d="M {left} {y_px(tick):.1f} h {width}" stroke="#ddd"/>' for tick in ticks)
    return f'{lines}<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>{texts}'


def _round_ticks(low: float, high: float) -> list[float]:
    """Three to six multiples of 1, 2 or 5 times a power of ten, whose range contains all values."""
    span = (high - low) or abs(high) or 1.0
    power = 10.0 ** math.floor(math.log10(span / 4.0))
    step = next(power * times for times in (1.0, 2.0, 5.0, 10.0) if power * times >= span / 4.0)
    first, last = math.floor(low / step), math.ceil(high / step)
    # A constant line lies between two ticks.
    return [step * count for count in range(first, max(last, first + 1) + 1)]


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
