"""The slider: two images of one view on top of each other, with an edge to drag between them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

from mirror_leaderboard.boards import Board
from mirror_leaderboard.entry import IMAGE_FOLDER, Measured, Pair

_TRUTH: Final = "recorded"


def board_slider(board: Board) -> str:
    """Format the slider of a board; empty if none of its entries has images."""
    titles: dict[str, str] = {}
    images: dict[str, dict[str, str]] = {}
    for method, pair in _list_pairs(board):
        titles.setdefault(pair.truth, pair.view)
        images.setdefault(pair.truth, {_TRUTH: _image_address(pair.truth)})[method] = _image_address(pair.render)
    if not titles:
        return ""
    views = [{"view": titles[truth], "images": by_method} for truth, by_method in images.items()]
    data = json.dumps(views, ensure_ascii=False).replace("<", "\\u003c")
    first = images[next(iter(titles))]
    names = list(first)
    choices = (("View", list(titles.values()), 0), ("Left", names, 0), ("Right", names, 1))
    choice = "".join(
        f"<label>{label} <select>{_format_options(values, selected)}</select></label>"
        for label, values, selected in choices
    )
    return (
        f'<figure class="slider"><figcaption>Side by side</figcaption><div class="choice">{choice}</div>'
        f'<div class="stage">{_format_side("right", names[1], first)}{_format_side("left", names[0], first)}'
        '<span class="edge" aria-hidden="true"></span>'
        '<input type="range" min="0" max="100" value="50" step="1" aria-label="Shown part of the left image">'
        f'</div><script type="application/json">{data}</script></figure>'
    )


def image_files(boards: Sequence[Board]) -> list[str]:
    """List the files that the sliders of the boards show."""
    return sorted({file for board in boards for _, pair in _list_pairs(board) for file in (pair.render, pair.truth)})


def _list_pairs(board: Board) -> Iterator[tuple[str, Pair]]:
    """List the pairs with the names of their methods, with version and setting if a method has several entries."""
    measured = [entry for entry in board.entries if isinstance(entry, Measured)]
    methods = Counter(entry.method for entry in measured)
    for entry in measured:
        full_name = ", ".join(filter(None, (f"{entry.method} {entry.version}", entry.setting)))
        for pair in entry.pairs:
            yield entry.method if methods[entry.method] == 1 else full_name, pair


def _image_address(file: str) -> str:
    return f"{IMAGE_FOLDER}/{file}"


def _format_side(side: str, name: str, images: dict[str, str]) -> str:
    return (
        f'<img class="{side}" src="{escape(images[name])}" alt="{escape(name)}" loading="lazy">'
        f'<span class="name {side}" aria-hidden="true">{escape(name)}</span>'
    )


def _format_options(values: Sequence[str], selected: int) -> str:
    return "".join(
        f"<option{' selected' if place == selected else ''}>{escape(value)}</option>"
        for place, value in enumerate(values)
    )
