"""DS009."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.schema.documents import is_identifier

_LAYER_KINDS = ("poses", "calibrations", "boxes", "masks", "redaction", "depth", "points")


@dataset_rule("DS009", Severity.ERROR, remedy="ids are assigned once: undo the renaming, or write the folder again")
def identifier(view: DatasetView) -> Iterator[Finding]:
    """A folder's name is no id: `drive`, `scene.drive.entry_ms`, or `kind/source@version` of a layer."""
    for folder in view.folders("drives"):
        if not is_identifier(folder.name):
            yield Finding(view.name(folder), None, "not a drive's id: letters, digits, `_` and `-`")
    for folder in view.folders("traversals"):
        parts = folder.name.split(".")
        if len(parts) != 3 or not (is_identifier(parts[0]) and is_identifier(parts[1]) and parts[2].isdigit()):
            yield Finding(view.name(folder), None, "not a traversal's id: scene.drive.entry_ms")
        for layer in view.layer_folders(folder.name):
            source, at, version = layer.name.partition("@")
            if layer.parent.name not in _LAYER_KINDS or not (source and at and version):
                yield Finding(view.name(layer), None, f"not a layer: {' | '.join(_LAYER_KINDS)}, then source@version")
