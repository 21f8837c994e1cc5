"""A strip of one view from day to night, between the recorded image and the true one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from benchmarks.studies.static_reconstruction.truth.lighting import EDITS, target_traversal, views_in
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel
from benchmarks.studies.tiles import sheet
from hybridworldsim.training.appearance import SWEEP
from mirror.arrays import UInt8
from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.png import encode_png
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes

_SHARES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
_CAMERA: Final = "front_wide"


def write_sweep(trained: TrainedModel, path: Path) -> None:
    """Write the strip as PNG: recorded, five renders from the first light to the other, the truth."""
    before, after = EDITS[0]
    views = [view for view in views_in(trained, before) if view.camera == _CAMERA] or views_in(trained, before)
    view = views[len(views) // 2]
    target, street = target_traversal(trained, after, view), trained.street
    tiles = [("recorded", street.recorded.image(view))]
    tiles += [(f"{share:.0%} {after}", image) for share, image in zip(_SHARES, _renders(trained, view, target))]
    tiles.append((f"true {after}", street.relit(view, target)))
    write_bytes(path, encode_png(sheet([tiles])))


def _renders(trained: TrainedModel, view: RenderView, target: str) -> list[UInt8]:
    """Renders of the view whose appearance goes from its own traversal's to another's."""
    # A sweep goes along frames: here they are all of one place.
    views = [view.model_copy(update={"frame_index": place}) for place in range(len(_SHARES))]
    appearance = AppearancePolicy(f"{SWEEP}{view.traversal_id}:{target}", views, everywhere=True)
    render = trained.entry.method.open(trained.model, appearance)
    return [render(one) for one in views]
