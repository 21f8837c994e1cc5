"""The page of the leaderboard, as text and in a browser."""

from __future__ import annotations

import csv
import json
import re
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import ClassVar

import pytest

from mirror.cli.main import main
from mirror.errors import DatasetError, ExitCode
from mirror.schema.files import write_json
from mirror_leaderboard.boards import make_boards
from mirror_leaderboard.command import PAPERS
from mirror_leaderboard.entry import IMAGE_FOLDER, Reported, load_entries
from mirror_leaderboard.site.page import build, build_site
from tests.leaderboard.browser import Browser
from tests.leaderboard.conftest import MEASURED, REPORTED, REPOSITORY, measured

MAX_BYTES = 120_000


class Tags(HTMLParser):
    """Parses all tags, and checks that each is closed."""

    VOID: ClassVar = {"meta", "img", "input", "br", "link", "hr"}

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_page_is_small_well_formed_and_self_contained(board: Path, tmp_path: Path) -> None:
    page = build([board], tmp_path / "site")
    text = page.read_text()
    assert len(text.encode()) < MAX_BYTES
    tags = Tags(text)
    assert tags.open == []
    for tag, attributes in tags.tags:
        assert tag not in ("link", "iframe", "object", "embed", "form")
        assert "style" not in attributes
        assert not any(name.startswith("on") for name in attributes)
        if "src" in attributes:
            assert (page.parent / str(attributes["src"])).is_file()
        if tag == "img":
            assert attributes.get("alt")
        if tag == "a":
            target = str(attributes["href"])
            assert target.startswith(("#", "https://")) or (page.parent / target).is_file()
            if target.startswith("#"):
                assert target[1:] in {attributes.get("id") for _, attributes in tags.tags}
    ids = [attributes["id"] for _, attributes in tags.tags if "id" in attributes]
    assert len(set(ids)) == len(ids)


def test_equal_entries_give_equal_bytes(board: Path, tmp_path: Path) -> None:
    assert build([board], tmp_path / "a").read_bytes() == build([board], tmp_path / "b").read_bytes()


def test_text_of_entries_is_escaped(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="pattern"):
        measured("a</script>", 20.0)
    quoted = measured("\"x' onload=y &amp;", 20.0, pairs=(), notes=("</script><script>alert(1)</script>",))
    text = build_site([quoted], [tmp_path], tmp_path / "site").read_text()
    assert "&lt;/script&gt;&lt;script&gt;alert(1)" in text
    assert "&#34;x&#39; onload=y &amp;amp;" in text
    assert text.count("<script") == 1


def test_missing_image_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"(truth|a)-0\.jpg"):
        build_site([measured("a", 20.0)], [tmp_path], tmp_path / "site")


def test_shipped_board_builds(tmp_path: Path) -> None:
    text = build([PAPERS, REPOSITORY / "leaderboard"], tmp_path).read_text()
    for entry in (*load_entries(REPORTED), *load_entries(MEASURED)):
        assert entry.method in text
    assert "17.73" in text
    assert "0.71" in text


def test_entries_of_later_boards_replace_earlier_ones(board: Path, tmp_path: Path) -> None:
    later = tmp_path / "later" / "entries"
    write_json(later / "measured-again.json", measured("mean_color", 35.0, result_hash="99" * 32, pairs=()))
    text = build([board, later.parent], tmp_path / "site", unsigned=True).read_text()
    assert "99999999" in text
    assert text.count('data-value="mean_color"') == 1
    assert text.count('data-value="nearest_frame"') == 1


def test_slider_names_the_settings_of_one_method(board: Path, tmp_path: Path) -> None:
    pairs = measured("mean_color", 20.0).pairs
    other = measured("nearest_frame", 30.0, setting="farther", result_hash="99" * 32, pairs=pairs)
    write_json(board / "entries" / "measured-other.json", other)
    text = build([board], tmp_path / "site", unsigned=True).read_text()
    for name in ("nearest_frame 1, farther", "nearest_frame 1", "mean_color"):
        assert text.count(f"<option>{name}</option>") + text.count(f"<option selected>{name}</option>") == 2


def test_older_protocol_is_marked(tmp_path: Path) -> None:
    new, old = (
        build_site([entry], [], tmp_path).read_text()
        for entry in (measured("a", 20.0, pairs=()), measured("a", 20.0, pairs=(), protocol_hash="01" * 32))
    )
    assert "an older version" not in new
    assert "an older version" in old
    # Each table has a plot of its own: no value of an older version stands beside one of today's.
    assert new.count('<figure class="plot">') == old.count('<figure class="plot">') == 1


def test_streets_with_a_public_seed_are_practice_sets(tmp_path: Path) -> None:
    public, secret = (
        build_site([measured("a", 20.0, pairs=(), dataset=title)], [], tmp_path).read_text()
        for title in ("synthetic street (demo, seed 0)", "MIRROR street")
    )
    assert "practice set" in public
    assert "practice set" not in secret
    assert all(table.is_practice for table in make_boards(load_entries(MEASURED)) if table.hashes is not None)


def test_page_without_entries(tmp_path: Path) -> None:
    assert "0 entries" in build_site([], [tmp_path], tmp_path / "site").read_text()


def test_metric_without_values_is_noted_and_has_no_column(tmp_path: Path) -> None:
    text = build_site([measured("a", 20.0, pairs=())], [], tmp_path / "site").read_text()
    assert "LPIPS alex: unavailable: alexnet" in text
    assert '">LPIPS alex <span' not in text
    assert '"dim">n/a' not in text


def test_plot_needs_time_and_value(tmp_path: Path) -> None:
    slow = measured("a", 20.0, pairs=(), frames_per_second=None)
    assert "<svg" not in build_site([slow], [tmp_path], tmp_path / "a").read_text()
    fast = measured("a", 20.0, pairs=())
    assert "<circle" in build_site([fast], [tmp_path], tmp_path / "b").read_text()


def test_each_dataset_has_a_plot_of_its_own(tmp_path: Path) -> None:
    entries = [
        measured(method, 20.0, pairs=(), dataset=dataset, result_hash=f"{number}1" * 32)
        for number, (method, dataset) in enumerate((("a", "one"), ("b", "one"), ("c", "two")))
    ]
    reported = load_entries(REPORTED)
    text = build_site([*entries, *reported], [], tmp_path / "site").read_text()
    panels = {name: text.split(f'data-tab="{name}')[1].split('class="panel"')[0] for name in ("one", "two", "MIRROR")}
    named = {name: set(re.findall(r"<title>([^:]+): ", panel)) for name, panel in panels.items()}
    assert [panel.count('<figure class="plot">') for panel in panels.values()] == [1, 1, 1]
    assert (named["one"], named["two"]) == ({"a", "b"}, {"c"})
    assert "HybridWorldSim" in named["MIRROR"] and not named["MIRROR"] & {"a", "b", "c"}


def test_papers_that_do_not_name_their_data_share_no_plot(tmp_path: Path) -> None:
    entries = [one for one in load_entries(REPORTED) if isinstance(one, Reported)]
    unnamed = [one.model_copy(update={"dataset": None}) for one in entries]
    assert "<svg" in build_site(unnamed, [], tmp_path / "one").read_text()
    other = [
        one.model_copy(update={"paper": one.paper.model_copy(update={"title": "Another"}), "method": "other"})
        for one in unnamed
    ]
    assert "<svg" not in build_site([*unnamed, *other], [], tmp_path / "two").read_text()


def test_rows_of_papers_are_shown_by_option(tmp_path: Path) -> None:
    own = tmp_path / "own" / "entries"
    write_json(own / "measured-a.json", measured("a", 20.0, pairs=()))
    kinds = {}
    for name, words in {"own": [], "both": ["--papers"]}.items():
        given = ["--board", str(own.parent), *words]
        assert (
            main(["leaderboard", "build", *given, "--unsigned", "--out", str(tmp_path / "site" / name)])
            == ExitCode.DONE
        )
        text = (tmp_path / "site" / name / "index.html").read_text()
        kinds[name] = set(re.findall(r'data-kind="(\w+)"', text))
    assert kinds["own"] == {"measured"} and kinds["both"] == {"measured", "reported"}


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (1280, True), (390, False), (320, True)])
def test_page_fits_without_warnings(browser: Browser, board: Path, tmp_path: Path, width: int, dark: bool) -> None:
    page = build([board], tmp_path / "site")
    browser.open(page, width=width, dark=dark)
    assert browser.script("document.documentElement.scrollWidth") <= width
    assert browser.warnings() == []
    assert all(url.startswith(page.parent.resolve().as_uri()) for url in browser.requested())
    browser.script("document.querySelectorAll('img').forEach(image => { image.loading = 'eager' })")
    loaded = "Promise.all([...document.images].map(image => image.decode().then(() => image.naturalWidth)))"
    assert all(size == 480 for size in browser.script(loaded))


def test_no_table_is_wider_than_a_window(browser: Browser, tmp_path: Path) -> None:
    """The shipped board fits the window: its widest protocol has six groups of three metrics."""
    browser.open(build([PAPERS, REPOSITORY / "leaderboard"], tmp_path / "site"), width=1280)
    wide = "[...document.querySelectorAll('.scroll')].filter(element => element.scrollWidth > element.clientWidth)"
    assert browser.script(f"{wide}.map(element => element.getAttribute('aria-label'))") == []
    heads = "[...document.querySelectorAll('table.board th.group')].map(head => head.textContent)"
    assert {"3 m right", "1 m right", "1 m left", "3 m left"} <= set(browser.script(heads))


@pytest.mark.parametrize("dark", [False, True])
def test_text_has_enough_contrast(browser: Browser, board: Path, tmp_path: Path, dark: bool) -> None:
    """WCAG AA requires a contrast of at least 4.5 between text and background."""
    browser.open(build([board], tmp_path / "site"), dark=dark)
    script = f"""[...document.querySelectorAll('{TEXTS}')].map(element => {{
      const isClear = (it) => getComputedStyle(it).backgroundColor === 'rgba(0, 0, 0, 0)';
      let back = element;
      while (back.parentElement && isClear(back)) back = back.parentElement;
      if (isClear(back)) back = document.body;
      const text = element.textContent.slice(0, 30);
      return [getComputedStyle(element).color, getComputedStyle(back).backgroundColor, text];
    }})"""
    for colour, background, text in browser.script(script):
        assert contrast(colour, background) >= 4.5, (colour, background, text)


TEXTS = "h1,h2,h3,p,td,th,button,small,a,li,.tag,label,figcaption"


def contrast(*colours: str) -> float:
    dark, bright = sorted(luminance(*map(int, re.findall(r"\d+", colour)[:3])) for colour in colours)
    return (bright + 0.05) / (dark + 0.05)


def luminance(*rgb: int) -> float:
    linear = [v / 12.92 if v <= 0.03928 else ((v + 0.055) / 1.055) ** 2.4 for v in (c / 255 for c in rgb)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


TABLE = "document.querySelector('[data-kind=measured] table.board')"
METHODS = f"[...{TABLE}.tBodies[0].rows].map(row => row.cells[1].dataset.value)"
HEADS = f"[...{TABLE}.querySelectorAll('thead th button')]"
SHOW_MEASURED = "document.querySelector('[role=tab]').click()"


def test_heads_sort(browser: Browser, board: Path, tmp_path: Path) -> None:
    browser.open(build([board], tmp_path / "site"))
    best = ["hybridworldsim", "nearest_frame", "mean_color"]
    assert browser.script(METHODS) == best
    # A click reverses the ranked column; another column starts with its best; rows without a value stay last.
    browser.script(f"{HEADS}[2].click()")
    assert browser.script(METHODS) == best[::-1]
    assert browser.script(f"{TABLE}.querySelector('th[aria-sort]').getAttribute('aria-sort')") == "ascending"
    browser.script(f"{HEADS}[3].click()")
    assert browser.script(METHODS) == best
    assert browser.script("document.querySelectorAll('table.board th[aria-sort]').length") >= 1
    browser.script(f"{HEADS}[1].click()")
    assert browser.script(METHODS) == sorted(best)
    browser.script(f"{HEADS}[7].click()")
    assert browser.script(METHODS) == ["mean_color", "hybridworldsim", "nearest_frame"]


def test_heads_sort_by_keyboard(browser: Browser, board: Path, tmp_path: Path) -> None:
    browser.open(build([board], tmp_path / "site"))
    browser.script(SHOW_MEASURED)
    browser.script(f"{HEADS}[2].focus()")
    for kind in ("keyDown", "keyUp"):
        browser.call(
            "Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r"
        )
    assert browser.script(METHODS) == ["mean_color", "nearest_frame", "hybridworldsim"]


def test_slider_moves_and_shows_the_selected_images(browser: Browser, board: Path, tmp_path: Path) -> None:
    browser.open(build([board], tmp_path / "site"))
    browser.script(SHOW_MEASURED)
    source = "document.querySelector('.stage img.{}').getAttribute('src')"
    assert browser.script(source.format("left")) == f"{IMAGE_FOLDER}/street/truth-0.jpg"
    assert browser.script(source.format("right")) == f"{IMAGE_FOLDER}/street/hybridworldsim-0.jpg"
    choose = "(() => {{ const s = document.querySelectorAll('.slider select')[{}]; s.selectedIndex = {};"
    choose += " s.dispatchEvent(new Event('change')) }})()"
    browser.script(choose.format(0, 1))
    browser.script(choose.format(1, 2))
    assert browser.script(source.format("left")) == f"{IMAGE_FOLDER}/street/nearest_frame-1.jpg"
    assert browser.script(source.format("right")) == f"{IMAGE_FOLDER}/street/hybridworldsim-1.jpg"
    browser.script("document.querySelector('.stage').scrollIntoView({behavior: 'instant'})")
    # Images load when they come into view, and would move the stage between the measurement of its place and the click.
    loaded = "[...document.querySelectorAll('.stage img')].every(image => image.complete)"
    until = time.monotonic() + 20.0
    while not browser.script(loaded) and time.monotonic() < until:
        time.sleep(0.02)
    browser.script("document.querySelector('.stage').scrollIntoView({behavior: 'instant'})")
    left, top, width, height = browser.script(
        "(r => [r.x, r.y, r.width, r.height])(document.querySelector('.stage').getBoundingClientRect())"
    )
    for kind in ("mousePressed", "mouseReleased"):
        place = {"x": left + 0.25 * width, "y": top + 0.5 * height}
        browser.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **place)
    at = browser.script("parseFloat(getComputedStyle(document.querySelector('.stage')).getPropertyValue('--at'))")
    assert at == pytest.approx(25, abs=3)


def test_tables_need_no_scripts(browser: Browser, board: Path, tmp_path: Path) -> None:
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(build([board], tmp_path / "site"))
        root = browser.call("DOM.getDocument")["root"]["nodeId"]
        for selector in ("[role=tab]", "[hidden]"):
            assert browser.call("DOM.querySelectorAll", nodeId=root, selector=selector)["nodeIds"] == []
        # The table of rendering, with many groups, is split: its rows are counted once.
        selector = ".panel .scroll:first-of-type tbody tr"
        rows = browser.call("DOM.querySelectorAll", nodeId=root, selector=selector)["nodeIds"]
        assert len(rows) == len(load_entries(board / "entries"))
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)


def test_measured_tables_come_first_and_tabs_show_one_at_a_time(browser: Browser, board: Path, tmp_path: Path) -> None:
    page = build([board], tmp_path / "site")
    kinds = re.findall(r'class="panel" id="([^"]*)" data-tab="([^"]*)" data-kind="(\w+)"', page.read_text())
    first = [kind for name, _, kind in kinds if name.startswith("static-reconstruction")]
    assert first == ["measured"] + ["reported"] * 3
    browser.open(page)
    section = "document.querySelector('#static-reconstruction')"
    shown = f"[...{section}.querySelectorAll('.panel')].filter(panel => !panel.hidden).map(panel => panel.dataset.tab)"
    assert browser.script(shown) == ["synthetic street, unverified"]
    browser.script(f"{section}.querySelectorAll('[role=tab]')[1].click()")
    assert browser.script(shown) == ["MIRROR"]
    browser.script(f"{section}.querySelectorAll('[role=tab]')[1].focus()")
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight", windowsVirtualKeyCode=39)
    assert browser.script(shown) == ["nuPlan"]
    browser.script(f"location.hash = '{kinds[3][0]}'")
    assert browser.script(f"new Promise(done => setTimeout(() => done({shown}), 50))") == [kinds[3][1]]
    selected = f"{section}.querySelectorAll('[role=tab][aria-selected=true]').length"
    assert browser.script(selected) == 1


def test_rows_have_a_date_and_a_link_to_their_entry(tmp_path: Path) -> None:
    entry = measured("a", 20.0, pairs=(), added="2026-11-25")
    reported = load_entries(REPORTED)
    page = build_site([entry, *reported], [], tmp_path / "site")
    text = page.read_text()
    assert '<time datetime="2026-11-25">2026-11-25</time>' in text
    assert text.count('<time datetime="2025-11">') >= len(reported)
    links = re.findall(r'href="(rows/[^"]*)">entry<', text)
    assert len(set(links)) == len(reported) + 1
    files = {name: json.loads((page.parent / name).read_text()) for name in links}
    assert [one for one in files.values() if one["kind"] == "measured"] == [entry.model_dump(mode="json")]


def test_csv_has_the_figures_of_the_table(tmp_path: Path) -> None:
    entries = [measured("b", 20.0, pairs=()), measured("=1+1", 21.0, pairs=())]
    page = build_site(entries, [], tmp_path / "site")
    (link,) = re.findall(r'href="(csv/[^"]*)" download', page.read_text())
    with (page.parent / link).open(newline="") as file:
        rows = list(csv.DictReader(file))
    # The order of the page; a spreadsheet takes no name for a formula.
    assert [row["method"] for row in rows] == ["'=1+1", "b"]
    for row, psnr in zip(rows, (21.0, 20.0)):
        assert float(row["novel psnr_invariant dB"]) == psnr + 3
        assert (float(row["novel psnr_invariant low"]), row["novel psnr_invariant n"]) == (psnr + 2.5, "35")


def test_footnotes_stand_once(tmp_path: Path) -> None:
    none = "no interval: fewer than 5 blocks"
    figures = [
        figure.model_copy(update={"low": None, "high": None, "note": f"2 grey; {none}" if number else none})
        for number, figure in enumerate(measured("a", 20.0).figures[:3])
    ]
    entries = [
        measured(method, 20.0, pairs=(), figures=tuple(figures), dataset=dataset)
        for method, dataset in (("a", "one"), ("b", "one"), ("c", "two"))
    ]
    text = build_site(entries, [], tmp_path / "site").read_text()
    notes = re.findall(r'<li value="(\d+)">(.*?)</li>', text)
    equal = "PSNR: 1 equal to the truth (infinite, left out of the mean)"
    # The column that ranks comes first.
    expected = ("Structure: 2 grey", none, "PSNR: 2 grey", equal)
    assert notes == [(str(k + 1), note) for k, note in enumerate(expected)]


def test_footnotes_of_a_tab_stand_below_its_table(browser: Browser, tmp_path: Path) -> None:
    notes = {"one": ("shared", "first"), "two": ("shared", "second")}
    entries = [measured("a", 20.0, pairs=(), notes=notes[dataset], dataset=dataset) for dataset in notes]
    browser.open(build_site(entries, [], tmp_path / "site"))
    section = "document.querySelector('#static-reconstruction')"
    shown = f"[...{section}.querySelectorAll('.notes li')].filter(note => !note.hidden).map(note => note.textContent)"
    table_above = f"{section}.querySelector('.panel:not([hidden]) > .scroll + .notes') !== null"
    numbers = f"{section}.querySelector('.panel:not([hidden]) th sup').textContent"
    for place, dataset in enumerate(notes):
        browser.script(f"{section}.querySelectorAll('[role=tab]')[{place}].click()")
        assert browser.script(table_above)
        written = browser.script(shown)
        assert set(notes[dataset]) <= set(written)
        assert not (set(notes["one"]) ^ set(notes["two"])) - set(notes[dataset]) & set(written)
        values = f"[...{section}.querySelectorAll('.notes li')].filter(note => !note.hidden).map(note => note.value)"
        assert {int(number) for number in browser.script(numbers).split(",")} <= set(browser.script(values))
