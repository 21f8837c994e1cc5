"""Commands that are killed, or interrupted, right after they wrote a layer: the same command goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.layer_writer import LayerWriter
from mirror.errors import DatasetError
from mirror.integrity import check


class Killed(BaseException):
    """Ends a process at once."""


def require_resumable(root: Path, words: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupt a command after its first layer, then kill it after the next; it finishes all the same.

    Args:
        root: the dataset; the command writes at least two layers into it.
        words: the command.
        monkeypatch: changes what is written.
    """
    finish = LayerWriter.finish

    def interrupted(*given: object) -> None:
        finish(*given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(LayerWriter, "finish", interrupted)
        assert main(list(words)) == 130
    # The next verbs find a valid index, with the layer.
    layers = [name for row in mirror.open(root).table("traversals", ["layers"]).to_pylist() for name in row["layers"]]
    assert len(layers) == len(list(root.glob("traversals/*/layers/*/*/manifest.json")))

    def killed(*given: object) -> None:
        raise Killed

    def finish_and_die(*given: object) -> None:
        finish(*given)
        patched.setattr("mirror.dataset.writing.build_index", killed)
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(LayerWriter, "finish", finish_and_die)
        with pytest.raises(Killed):
            main(list(words))
    with pytest.raises(DatasetError, match="index is stale"):
        mirror.open(root)
    assert main(list(words)) == 0
    assert main(list(words)) == 0
    assert mirror.open(root).count("traversals") and not check(root, only=["IDX"]).findings
