"""Two pictures of one view on top of each other, with an edge to drag between them."""

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
    """The slider of a board; empty if none of its entries has pictures."""
    titles: dict[str, str] = {}
    pictures: dict[str, dict[str, str]] = {}
    for method, pair in _pairs(board):
        titles.setdefault(pair.truth, pair.view)
        pictures.setdefault(pair.truth, {_TRUTH: _place(pair.truth)})[method] = _place(pair.render)
    if not titles:
        return ""
    views = [{"view": titles[truth], "pictures": own} for truth, own in pictures.items()]
    data = json.dumps(views, ensure_ascii=False).replace("<", "\\u003c")
    first = pictures[next(iter(titles))]
    names = list(first)
    choices = (("View", list(titles.values()), 0), ("Left", names, 0), ("Right", names, 1))
    choice = "".join(f"<label>{label} <select>{_options(own, at)}</select></label>" for label, own, at in choices)
    return (
        f'<figure class="slider"><figcaption>Side by side</figcaption><div class="choice">{choice}</div>'
        f'<div class="stage">{_side("right", names[1], first)}{_side("left", names[0], first)}'
        '<span class="edge" aria-hidden="true"></span>'
        '<input type="range" min="0" max="100" value="50" step="1" aria-label="How much of the left picture is shown">'
        f'</div><script type="application/json">{data}</script></figure>'
    )


def image_files(boards: Sequence[Board]) -> list[str]:
    """The files that the sliders of boards show."""
    return sorted({file for board in boards for _, pair in _pairs(board) for file in (pair.render, pair.truth)})


def _pairs(board: Board) -> Iterator[tuple[str, Pair]]:
    """Each pair with its method's name, and with what tells it from other entries of that."""
    measured = [entry for entry in board.entries if isinstance(entry, Measured)]
    methods = Counter(entry.method for entry in measured)
    for entry in measured:
        whole = ", ".join(filter(None, (f"{entry.method} {entry.version}", entry.setting)))
        for pair in entry.pairs:
            yield entry.method if methods[entry.method] == 1 else whole, pair


def _place(file: str) -> str:
    return f"{IMAGE_FOLDER}/{file}"


def _side(side: str, name: str, pictures: dict[str, str]) -> str:
    return (
        f'<img class="{side}" src="{escape(pictures[name])}" alt="{escape(name)}" loading="lazy">'
        f'<span class="name {side}" aria-hidden="true">{escape(name)}</span>'
    )


def _options(values: Sequence[str], chosen: int) -> str:
    return "".join(
        f"<option{' selected' if place == chosen else ''}>{escape(value)}</option>"
        for place, value in enumerate(values)
    )
