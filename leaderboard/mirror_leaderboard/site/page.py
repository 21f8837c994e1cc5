"""The page of the leaderboard: a tab for each board of a protocol, plots, sliders, a guide; no network access."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from typing import Final

from mirror.errors import DatasetError
from mirror.html import style_sheet
from mirror.metrics.catalogue import MEASURES
from mirror.protocols.document import load_protocol
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.version import __version__
from mirror_leaderboard.boards import STATED, UNVERIFIED, Board, make_boards
from mirror_leaderboard.entry import IMAGE_FOLDER, Entry, Measured, entry_key, load_entries
from mirror_leaderboard.site.downloads import csv_file, encode_board, encode_entry, entry_file
from mirror_leaderboard.site.guide import GUIDE
from mirror_leaderboard.site.plot import time_quality_plot
from mirror_leaderboard.site.slider import board_slider, image_files
from mirror_leaderboard.site.tables import board_table, format_notes, group_title
from mirror_leaderboard.trust import require_trusted

_TITLE: Final = "MIRROR leaderboard"
_MARK: Final = ".made-by-mirror-leaderboard"
_DRAFT: Final = "<p><b>Draft.</b> Nobody signed these rows: they may be wrong.</p>"
_PRACTICE: Final = (
    " <small><b>practice set</b>: anybody can make the images that are scored from the public seed in its name</small>"
)
_KINDS: Final = (
    '<p><span class="tag measured">measured</span>: scored here; the hashes identify the result, the protocol and the '
    'data. <span class="tag reported">reported</span>: printed in a paper, from its authors’ evaluation; never ranked '
    'with measured figures. <span class="tag floor">floor</span>: a baseline that only shows recorded pixels; every '
    "method must beat it. <b>Bold</b>: the best value of a table. Small figures: 95 % confidence intervals.</p>"
)


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
    for entry in entries:
        write_bytes(out / entry_file(entry), encode_entry(entry))
    page = out / "index.html"
    write_bytes(page, _format_page(boards, entries, draft=draft).encode())
    return page


def _format_page(boards: Sequence[Board], entries: Sequence[Entry], *, draft: bool) -> str:
    style = style_sheet() + files("mirror_leaderboard.site").joinpath("site.css").read_text()
    script = files("mirror_leaderboard.site").joinpath("site.js").read_text()
    policy = (
        f"default-src 'none'; img-src 'self' file:; style-src '{_source_hash(style)}'; "
        f"script-src '{_source_hash(script)}'; base-uri 'none'; form-action 'none'"
    )
    sections = [(protocol, list(group)) for protocol, group in groupby(boards, key=lambda board: board.protocol)]
    links = "".join(f'<li><a href="#{escape(protocol)}">{escape(protocol)}</a></li>' for protocol, _ in sections)
    measured = sum(isinstance(entry, Measured) for entry in entries)
    counts = f"{len(entries)} entries, {measured} of them measured, in {len(boards)} tables."
    body = (
        f'<main><header><h1>{_TITLE}</h1><p class="dim">{counts}</p>{_DRAFT if draft else ""}{_KINDS}'
        f'<nav aria-label="Protocols"><ul>{links}'
        '<li><a href="#submit">how to submit</a></li></ul></nav></header>'
        f"{''.join(_format_section(protocol, group, entries) for protocol, group in sections)}{GUIDE}"
        f"<footer>Made by mirror {escape(__version__)}; static files, no server.</footer></main>"
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><title>{_TITLE}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style}</style></head><body>{body}<script>{script}</script></body></html>\n"
    )


def _format_section(protocol: str, boards: Sequence[Board], entries: Sequence[Entry]) -> str:
    about = " ".join(load_protocol(protocol).description.split())
    notes: dict[str, int] = {}
    panels = "".join(_format_panel(board, notes, entries) for board in boards)
    return (
        f'<section id="{escape(protocol)}"><h2>{escape(protocol)}</h2>'
        f"<details><summary>What the protocol scores</summary><p>{escape(about)}</p></details>"
        f'<div class="tabs">{panels}</div>{format_notes(notes)}</section>'
    )


def _format_panel(board: Board, notes: dict[str, int], entries: Sequence[Entry]) -> str:
    """Format a board. The script shows one panel of a section at a time; without it all are shown."""
    kind = "reported" if board.hashes is None else "measured"
    words = [*(["practice set"] if board.is_practice else []), *([_version_word(board)] if board.is_older else [])]
    label = ", ".join([board.title, *words, *map(_tab_word, board.options)])
    return (
        f'<div class="panel" id="{board.id}" data-tab="{escape(label)}" data-kind="{kind}">'
        f"{_format_heading(board)}{board_table(board, notes)}{time_quality_plot(board, entries)}{board_slider(board)}"
        "</div>"
    )


def _version_word(board: Board) -> str:
    """Name the version of an older board's protocol."""
    return "older version" if board.version is None else f"version {board.version}"


def _tab_word(option: tuple[str, str]) -> str:
    """Name an option of a board in its tab: hashes of hidden truth are left to the heading."""
    return {UNVERIFIED: "unverified", STATED: "stated", "hidden truth": f"truth {option[1][:4]}"}.get(
        option[0], " ".join(option)
    )


def _format_heading(board: Board) -> str:
    evidence = _PRACTICE if board.is_practice else ""
    if board.split is not None and board.hashes is not None:
        hashes = zip(("protocol", "data", "plan"), board.hashes)
        codes = "".join(f' · {name} <code title="{digest}">{digest[:8]}</code>' for name, digest in hashes)
        older = f" · {_version_word(board)}, an older version of the protocol" if board.is_older else ""
        codes += "".join(f" · {escape(name)} {escape(value)}" for name, value in board.options)
        evidence += f" <small>split {escape(board.split)}{codes}{older}</small>"
    ranked = f"{group_title(board.ranked_by[0])}, {MEASURES[board.ranked_by[1]].title}"
    word = "ordered" if MEASURES[board.ranked_by[1]].forgeable else "ranked"
    separator = "· " if evidence else ""
    download = f' <small>{separator}{word} by {escape(ranked)} · <a href="{csv_file(board)}" download>CSV</a></small>'
    return f"<h3>{escape(board.title)}{evidence}{download}</h3>"


def _copy_images(names: Iterable[str], sources: Sequence[Path], out: Path) -> None:
    for name in names:
        file = next((source / name for source in sources if (source / name).is_file()), None)
        if file is None:
            raise DatasetError("missing", file=name, expected=f"in {' or '.join(map(str, sources)) or 'some folder'}")
        write_bytes(out / name, file.read_bytes())


def _source_hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


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
