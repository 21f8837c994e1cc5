"""The help of commands, as users read it."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout, suppress
from functools import cache

from mirror.cli.main import main


@cache
def help_of(words: str) -> str:
    said = io.StringIO()
    with redirect_stdout(said), suppress(SystemExit):
        main([*words.split(), "--help"])
    assert said.getvalue().startswith("usage: "), words
    return said.getvalue()


@cache
def options_of(words: str) -> frozenset[str]:
    return frozenset(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", help_of(words)))
