"""Verbs of `mirror` and a short protocol, as the benchmarks of calibration use them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import mirror
from mirror.cli.main import main
from mirror.errors import DatasetError, ExitCode
from mirror.protocols.document import load_protocol

METRICS: Final = ("psnr", "psnr_invariant")


def run_verb(verb: str, *words: object, partly: bool = False) -> None:
    """Run a verb.

    Args:
        verb: its name.
        words: its further words.
        partly: accept the code 3: partly done.

    Raises:
        DatasetError: it did not end with 0.
    """
    print(f"$ mirror {verb} ...", flush=True)
    code = main([verb, *map(str, words)])
    if code and not (partly and code == ExitCode.PARTLY_DONE):
        raise DatasetError(f"`mirror {verb}` ended with {code}", expected="0")


def shorten_protocol(name: str, renamed: str, width_px: int) -> str:
    """Return a protocol of `mirror` in the width of a training, scored by PSNR alone."""
    text = (Path(mirror.__file__).parent / "protocols" / "definitions" / f"{name}.toml").read_text()
    text, metrics, rest = text.partition("[[metrics]]")
    text = text.replace(f'name = "{name}"', f'name = "{renamed}"')
    head, ranking, rest_of_text = text.partition("[ranking]")
    text = head + ranking + re.sub(r'metric = "\w+"', f'metric = "{METRICS[-1]}"', rest_of_text, count=1)
    text = text.replace(f"max_width_px = {load_protocol(name).pixels.max_width_px}", f"max_width_px = {width_px}")
    return (
        text + "".join(f'{metrics}\nmetric = "{metric}"\n\n' for metric in METRICS) + rest[rest.index("[intervals]") :]
    )
