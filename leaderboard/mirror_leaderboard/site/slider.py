"""The slider: two images of one view on top of each other, with an edge to drag between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from mirror.pages.rendering import script_data
from mirror_leaderboard.boards import Board
from mirror_leaderboard.entry import IMAGE_FOLDER, Measured, Pair

_TRUTH: Final = "recorded"


def board_slider(board: Board) -> dict[str, object] | None:
    """Return the content of a board's slider; None if no entry has images."""
    titles: dict[str, str] = {}
    images: dict[str, dict[str, str]] = {}
    for method, pair in _list_pairs(board):
        titles.setdefault(pair.truth, pair.view)
        images.setdefault(pair.truth, {_TRUTH: _image_address(pair.truth)})[method] = _image_address(pair.render)
    if not titles:
        return None
    views = [{"view": titles[truth], "images": by_method} for truth, by_method in images.items()]
    first = images[next(iter(titles))]
    names = list(first)
    return {
        "choices": [("View", list(titles.values()), 0), ("Left", names, 0), ("Right", names, 1)],
        "sides": [("right", names[1], first[names[1]]), ("left", names[0], first[names[0]])],
        "data": script_data(views),
    }


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
