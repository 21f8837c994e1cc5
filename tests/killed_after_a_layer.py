"""Commands that are interrupted, then killed, right after they wrote a layer: the same command goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mirror
from mirror.cli.main import main
from mirror.integrity import check
from tests.interruption import interrupt_before, kill_command_before


def require_resumable(root: Path, words: Sequence[str]) -> None:
    """Interrupt a command after its first layer, then kill it after all of them; it finishes all the same.

    Args:
        root: the dataset; the command writes at least two layers into it.
        words: the command.
    """
    with interrupt_before("layers/*/*", 2):
        assert main(list(words)) == 130
    # The next verbs find a valid index, with the layer.
    layers = [name for row in mirror.open(root).table("traversals", ["layers"]).to_pylist() for name in row["layers"]]
    assert len(layers) == len(list(root.glob("traversals/*/layers/*/*/manifest.json")))
    kill_command_before("index/snapshots/*", 1, words)
    assert [rule.rule_id for rule, _ in check(root, only=["IDX"]).findings] == ["IDX002"]
    assert main(list(words)) == 0
    assert main(list(words)) == 0
    assert mirror.open(root).count("traversals") and not check(root, only=["IDX"]).findings
