"""What looks like a URL on the command line and is none; `test_wrong_inputs` has the URLs that verbs refuse."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.command_line import local_path


@pytest.mark.parametrize("path", ["c:/data", "a:b/c", "12:30/x"])
def test_what_is_no_url_is_a_path(path: str) -> None:
    assert local_path(Path(path)) == Path(path)
