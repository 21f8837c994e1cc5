"""The site of a report: its data are the tables; its script filters, sorts and enlarges; names cannot break it."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.view.images import Passage, choose_passages
from mirror.view.report_site import write_site
from tests.leaderboard.browser import Browser


@pytest.fixture(scope="module")
def site(street: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(street, tmp_path_factory.mktemp("site") / "out", "A </script><b>title").parent


def test_pages_hold_the_rows_of_the_tables_and_need_no_network(street: Dataset, site: Path) -> None:
    assert sorted(path.relative_to(site).as_posix() for path in site.rglob("*.html")) == ["index.html", "scenes/a.html"]
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert not re.search(r'(src|href)="(?!data:|\.\./index\.html|scenes/)', text)
        assert "<b>title" not in text
    text = (site / "index.html").read_text()
    tables = [json.loads(found) for found in re.findall(r'<script type="application/json">(.*?)</script>', text)]
    assert [table["name"] for table in tables] == ["traversals", "passes"]
    traversals = tables[0]
    rows = [dict(zip(traversals["columns"], row)) for row in traversals["rows"]]
    for row, expected in zip(rows, street.table("traversals").to_pylist(), strict=True):
        assert row["traversal"] == expected["traversal_id"]
        assert row["light"] == expected["light"]
        assert row["path_m"] == expected["path_m"]
    assert len(tables[1]["rows"]) == street.count("passes")


def test_the_script_filters_sorts_and_enlarges(street: Dataset, site: Path, browser: Browser) -> None:
    browser.open(site / "index.html")
    rows = "document.querySelectorAll('section.table')[0].querySelectorAll('tbody tr')"
    where = "document.querySelector('.where').textContent"
    assert browser.script(f"{rows}.length") == 2
    assert browser.script(where) == "dataset"
    browser.script("(()=>{const s=document.querySelector('select[name=light]'); s.value='night'; s.onchange()})()")
    assert browser.script(f"{rows}.length") == 1
    line = browser.script(where)
    assert line == 'dataset.where(light="night")'
    assert eval(line, {"dataset": street}).traversals() == [street.traversals()[1]]
    browser.script("(()=>{const s=document.querySelector('select[name=light]'); s.value='all'; s.onchange()})()")
    button = "document.querySelectorAll('section.table')[0].querySelectorAll('th button')[1]"
    texts = []
    for _ in range(2):
        browser.script(f"{button}.click()")
        texts.append(browser.script(f"[...{rows}].map(row => row.children[1].textContent).join(' ')"))
    assert texts == [" ".join(street.traversals()), " ".join(reversed(street.traversals()))]
    assert browser.warnings() == []
    browser.open(site / "scenes" / "a.html")
    assert browser.script("document.querySelector('dialog').open") is False
    if browser.script("document.querySelectorAll('.shot img').length"):
        browser.script("document.querySelector('.shot img').click()")
        assert browser.script("document.querySelector('dialog').open") is True
    assert browser.warnings() == []


def test_no_light_or_weather_is_left_out() -> None:
    conditions = [("day", "clear")] * 30 + [("day", "rain")] * 2 + [("night", "clear")]
    passages = [
        Passage({"light": light, "weather": weather}, number, 0.0, is_same_direction=True)
        for number, (light, weather) in enumerate(conditions)
    ]
    chosen = choose_passages(passages, 6)
    assert [passage.frame_index for passage in chosen] == [0, 1, 2, 30, 31, 32]
    assert choose_passages(passages, 40) == passages


def test_a_thousand_traversals_open_in_two_seconds(site: Path, browser: Browser, tmp_path: Path) -> None:
    """The page of the small dataset with its rows repeated."""
    text = (site / "index.html").read_text()

    def repeat(found: re.Match[str]) -> str:
        table = json.loads(found[1])
        table["rows"] = [row for _ in range(500) for row in table["rows"]]
        return f'<script type="application/json">{json.dumps(table)}</script>'

    page = tmp_path / "large.html"
    page.write_text(re.sub(r'<script type="application/json">(.*?)</script>', repeat, text))
    taken = []
    for _ in range(3):
        begun = time.monotonic()
        browser.open(page)
        taken.append(time.monotonic() - begun)
    assert browser.script("document.querySelector('.about').textContent") == "1,000 of 1,000 rows"
    assert min(taken) < 2.0


def test_the_verb_writes_a_page_or_a_site(street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", street.root, "--out", str(tmp_path / "site")]) == 0
    assert capsys.readouterr().out.strip() == f"report: {tmp_path / 'site' / 'index.html'}"
    assert main(["report", street.root, "--out", str(tmp_path / "site")]) == 0
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    assert main(["report", street.root, "--out", str(tmp_path / "other")]) == 2
    assert main(["report", street.root, "--out", street.root]) == 2
    with pytest.raises(UsageError, match="inside"):
        write_site(street, Path(street.root) / "site")
