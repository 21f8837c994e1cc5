"""Layers of a dataset that options of a command name; errors name these options."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from mirror.errors import UsageError

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset


def with_named_layers(
    dataset: Dataset, scene: str | None, named: Mapping[str, str | None], *, read: Collection[str]
) -> Dataset:
    """Return a view that reads the named layers.

    Args:
        dataset: the view.
        scene: the scene of which layers are read; None: all.
        named: ``source@version`` or None by kind: poses, boxes, points. The option of a kind is ``--<kind>``.
        read: the kinds of which the command reads the only layer where none is named.

    Raises:
        UsageError: there is no such layer, or a traversal has several layers of a kind that is read and none is named.
    """
    view = dataset if scene is None else dataset.where(scene=scene)
    rows = view.table("traversals", ["traversal_id", "layers"]).to_pylist()
    for kind, layer in named.items():
        found = {row["traversal_id"]: _of_kind(row["layers"], kind) for row in rows}
        if layer is not None:
            _require_layer(kind, layer, found)
        elif kind in read:
            _require_one(kind, found)
    return dataset.with_layers(**named)


def _of_kind(layers: Sequence[str], kind: str) -> list[str]:
    return sorted(name.removeprefix(f"{kind}/") for name in layers if name.startswith(f"{kind}/"))


def _require_layer(kind: str, layer: str, found: Mapping[str, Sequence[str]]) -> None:
    without = [traversal for traversal, names in found.items() if layer not in names]
    existing = sorted({name for names in found.values() for name in names})
    # Points are those of the traversals that have them.
    if found and (len(without) == len(found) or (without and kind != "points")):
        raise UsageError(
            f"{len(without)} of {len(found)} traversals have no {kind} of {layer}, the first is {without[0]}",
            place=f"--{kind}",
            expected=f"a layer of all traversals; there are {', '.join(existing) or 'none'}",
            remedy=f"name another with --{kind}, or with --scene a scene whose traversals all have it",
        )


def _require_one(kind: str, found: Mapping[str, Sequence[str]]) -> None:
    for traversal, names in found.items():
        if len(names) > 1:
            raise UsageError(
                f"traversal {traversal} has {kind} of {', '.join(names)}",
                place=f"--{kind}",
                expected="one layer",
                remedy=f"name it: --{kind} {names[-1]}",
            )
