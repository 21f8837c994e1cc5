"""The page of the leaderboard: a tab for each board of a protocol, plots, sliders, a guide; no network access."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Final

from mirror.counting import count_of
from mirror.errors import DatasetError
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.images.bootstrap import CONFIDENCE
from mirror.pages.rendering import content_policy, read_script, render_page
from mirror.protocols.document import load_protocol
from mirror.protocols.ranking import group_title
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror_leaderboard.boards import STATED, UNVERIFIED, Board, make_boards
from mirror_leaderboard.entry import IMAGE_FOLDER, Entry, Measured, entry_key, load_entries
from mirror_leaderboard.ranks import BoardRanks
from mirror_leaderboard.site.downloads import csv_file, encode_board, encode_entry, encode_ranks, entry_file, rank_file
from mirror_leaderboard.site.plot import time_quality_plot
from mirror_leaderboard.site.slider import board_slider, image_files
from mirror_leaderboard.site.tables import board_tables
from mirror_leaderboard.trust import require_trusted

_TITLE: Final = "MIRROR leaderboard"
_MARK: Final = ".made-by-mirror-leaderboard"


def build_site(entries: Sequence[Entry], image_folders: Sequence[Path], out: Path, *, draft: bool = False) -> Path:
    """Write the site.

    Args:
        entries: the entries to show.
        image_folders: folders with the entries' images.
        out: folder of the site: new, empty, or written by an earlier run. Its page, images, tables and entries are
            replaced; other files stay.
        draft: whether the page says that nobody signed its entries.

    Returns:
        The file of the page.

    Raises:
        UsageError: the folder holds other files.
        DatasetError: an image is missing, or the folder cannot be written.
    """
    require_output_folder(out, FolderKind.SITE)
    write_bytes(out / _MARK, b"`mirror leaderboard build` writes this folder.\n")
    boards = make_boards(entries)
    _copy_images(image_files(boards), image_folders, out / IMAGE_FOLDER)
    for board in boards:
        write_bytes(out / csv_file(board), encode_board(board))
        if board.ranks is not None:
            write_bytes(out / rank_file(board), encode_ranks(board))
    for entry in entries:
        write_bytes(out / entry_file(entry), encode_entry(entry))
    page = out / "index.html"
    write_bytes(page, _format_page(boards, entries, draft=draft).encode())
    return page


def _format_page(boards: Sequence[Board], entries: Sequence[Entry], *, draft: bool) -> str:
    script = read_script("mirror_leaderboard.site", "site.js")
    measured = sum(isinstance(entry, Measured) for entry in entries)
    return render_page(
        "mirror_leaderboard.site",
        "board.html",
        title=_TITLE,
        policy=content_policy(script, images="'self' file:"),
        script=script,
        counts=f"{len(entries)} entries, {measured} of them measured, in {len(boards)} tables.",
        draft=draft,
        sections=[
            _arrange_section(protocol, list(group), entries)
            for protocol, group in groupby(boards, key=lambda board: board.protocol)
        ],
    )


def _arrange_section(protocol: str, boards: Sequence[Board], entries: Sequence[Entry]) -> dict[str, object]:
    about = " ".join(load_protocol(protocol).description.split())
    notes: dict[str, int] = {}
    panels = [_arrange_panel(board, notes, entries) for board in boards]
    return {"protocol": protocol, "about": about, "panels": panels, "notes": notes}


def _arrange_panel(board: Board, notes: dict[str, int], entries: Sequence[Entry]) -> dict[str, object]:
    words = [*(["practice set"] if board.is_practice else []), *([_version_word(board)] if board.is_older else [])]
    return {
        "id": board.id,
        "label": ", ".join([board.title, *words, *map(_tab_word, board.options)]),
        "kind": "reported" if board.hashes is None else "measured",
        "heading": _describe_board(board),
        "tables": board_tables(board, notes),
        "plot": time_quality_plot(board, entries),
        "slider": board_slider(board),
    }


def _version_word(board: Board) -> str:
    """Name the version of an older board's protocol."""
    return "older version" if board.version is None else f"version {board.version}"


def _tab_word(option: tuple[str, str]) -> str:
    """Name an option of a board in its tab: hashes of hidden truth are left to the heading."""
    return {UNVERIFIED: "unverified", STATED: "stated", "hidden truth": f"truth {option[1][:4]}"}.get(
        option[0], " ".join(option)
    )


def _describe_board(board: Board) -> dict[str, object]:
    """Return what the heading of a board states."""
    group, metric = board.ranked_by
    is_measured = board.split is not None and board.hashes is not None
    return {
        "title": board.title,
        "is_practice": board.is_practice,
        "split": board.split if is_measured else None,
        "hashes": list(zip(("protocol", "data", "plan"), board.hashes or ())),
        "options": board.options,
        "older": _version_word(board) if board.is_older else None,
        "order": "ordered" if MEASURES[metric].forgeable else "ranked",
        "ranked_by": f"{group_title(group)}, {MEASURES[metric].title}",
        "csv": csv_file(board),
        "ranks": None if board.ranks is None else rank_file(board),
        "rank_note": None if board.ranks is None else _describe_ranks(board.ranks),
    }


def _describe_ranks(ranks: BoardRanks) -> str:
    """Return what the heading of a board states of its ranks."""
    if ranks.reason is not None:
        return f"ranks without intervals: {ranks.reason}"
    return f"ranks with {100 * CONFIDENCE:g} % intervals over {count_of(ranks.n_clusters, ranks.cluster)}"


def _copy_images(names: Iterable[str], sources: Sequence[Path], out: Path) -> None:
    for name in names:
        file = next((source / name for source in sources if (source / name).is_file()), None)
        if file is None:
            raise DatasetError("missing", file=name, expected=f"in {' or '.join(map(str, sources)) or 'some folder'}")
        write_bytes(out / name, file.read_bytes())


def build(boards: Sequence[Path], out: Path, *, unsigned: bool = False) -> Path:
    """Build the site of several boards; see `build_site` and `load_entries`.

    An entry of a later board replaces the entry with the same key of an earlier board.

    Args:
        boards: folders of the boards.
        out: folder of the site.
        unsigned: whether to show entries without signature and review, on a page that is marked as a draft.

    Raises:
        RefusedError: an entry is neither signed nor reviewed.
    """
    entries = {}
    for board in boards:
        found = load_entries(board / "entries")
        if not unsigned:
            require_trusted(board, found)
        entries.update({entry_key(entry): entry for entry in found})
    return build_site(list(entries.values()), [board / IMAGE_FOLDER for board in boards], out, draft=unsigned)
