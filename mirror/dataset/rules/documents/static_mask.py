"""DS012."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Cost, Finding, Severity, dataset_rule
from mirror.dataset.pictures.still import decode_grey


@dataset_rule("DS012", Severity.ERROR, cost=Cost.FILES, remedy="restore the mask beside the rig's file")
def static_mask(view: DatasetView) -> Iterator[Finding]:
    """A static mask that a rig names is missing, or is not a PNG."""
    for rig_id, rig in view.rigs.items():
        for camera in rig.cameras:
            if camera.static_mask is None:
                continue
            path = view.layout.rig(rig_id).parent / camera.static_mask
            if not path.is_file():
                yield Finding(
                    f"rigs/{camera.static_mask}", None, f"missing, but camera {camera.name} of the rig names it"
                )
            elif decode_grey(path.read_bytes()) is None:
                yield Finding(f"rigs/{camera.static_mask}", None, "cannot be decoded")
