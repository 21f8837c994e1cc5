"""The commands of docs/benchmark.md, from the published dataset to the row on the board."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from mirror.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "benchmark.md"


def test_commands_lead_from_the_data_to_a_row(
    root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    commands = [shlex.split(line) for block in blocks for line in block.splitlines()]
    assert [words[1] for words in commands[:3]] == ["synth", "ingest", "split"]
    # The street of the tests stands in for the larger one.
    shutil.copytree(root, tmp_path / "full")
    monkeypatch.chdir(tmp_path)
    # The licence is that of the data; two worker processes would import all that this one has.
    one_process = ["--workers", "1"]
    more = {
        "dataset publish": ["--licence", "CC0-1.0"], "evaluate full": one_process, "leaderboard add": one_process,
    }  # fmt: skip
    for words in commands[3:]:
        assert words[0] == "mirror"
        assert main([*words[1:], *more.get(" ".join(words[1:3]), [])]) == 0, (words, capsys.readouterr().err)
    page = (tmp_path / "site" / "index.html").read_text()
    assert "MIRROR street" in page and "nearest_frame" in page
