"""URLs on the command line: read where a verb can, refused in words where it cannot."""

from __future__ import annotations

import pytest

from mirror.cli.main import main


@pytest.mark.parametrize("verb", ["check", "info", "index"])
def test_verbs_that_take_a_folder_say_so(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, "memory://x"]) == 2
    error = capsys.readouterr().err
    assert "memory://x: this verb takes a path, not a URL" in error


@pytest.mark.parametrize("verb", ["stats", "report"])
def test_an_unknown_protocol_is_named(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, "foo://x"]) == 2
    error = capsys.readouterr().err
    assert "foo://x: this URL cannot be opened" in error
    assert "Remedy: pip install" in error


def test_a_url_without_a_dataset(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "memory://nothing"]) == 2
    assert "memory://nothing" in capsys.readouterr().err
