"""The truth of views: recorded images of a dataset, or hidden images that only the organiser has."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mirror.arrays import Bool, UInt8
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame, FrameSequence
from mirror.dataset.image import Image
from mirror.errors import DatasetError
from mirror.protocols.document import Protocol
from mirror.protocols.png import RenderError, decode_render
from mirror.protocols.views.view import RenderView

_OPEN_TRAVERSALS: Final = 16
"""Number of traversals that stay open, because training reads images of all traversals in random order."""


class GroundTruth:
    """A reader of the true image and the scored mask of one view at a time.

    Args:
        dataset: dataset with the recorded images.
        protocol: protocol with the raster and mask settings.
        layers: mask and box layers by traversal, as in `Plan.layers`.
        hidden: folder of hidden truth in the layout of a submission; None: the recorded images of the dataset. Moved
            and edited views have no recorded truth.
    """

    def __init__(
        self, dataset: Dataset, protocol: Protocol, layers: dict[str, tuple[str, ...]], hidden: Path | None = None
    ) -> None:
        self._dataset, self._protocol, self._layers, self._hidden = dataset, protocol, layers, hidden
        self._traversals: OrderedDict[str, tuple[FrameSequence, dict[int, int]]] = OrderedDict()
        self._frame: tuple[str, Frame] | None = None
        self._hashes = ContentHashes(dataset.store)

    def image(self, view: RenderView) -> UInt8:
        """Read the true image (H, W, 3), RGB, in the view's raster.

        Raises:
            DatasetError: the image is missing or damaged.
        """
        if self._hidden is not None:
            try:
                return decode_render(_read_hidden(self._hidden, view), view.width_px, view.height_px, view.path)
            except RenderError as error:
                # A render error would blame the submission.
                raise DatasetError(
                    f"the true image is damaged ({error.problem})",
                    file=self._hidden / view.path,
                    place="--hidden",
                    remedy="restore the image, or render the hidden truth again",
                ) from error
        # Imported late, as below: OpenCV would take a tenth of the time of a run that finds every image scored.
        from mirror.protocols.truth.raster import cached_raster

        _, image = self.recorded_frame_and_image(view)
        return cached_raster(image.camera_model, self._protocol.pixels).to_final(image.decode())

    def scored_mask(self, view: RenderView) -> Bool:
        """Compute the mask (H, W) of scored pixels; see `compute_scored_mask`."""
        from mirror.protocols.truth.scored import compute_scored_mask

        frame, image = self.recorded_frame_and_image(view)
        return compute_scored_mask(self._protocol, view, frame, image, self._layers.get(view.traversal_id, ()))

    def outside_lens(self, view: RenderView) -> Bool:
        """Compute the mask (H, W) of pixels outside the lens's field of view, which are black in `image`."""
        from mirror.protocols.truth.raster import cached_raster

        _, image = self.recorded_frame_and_image(view)
        return cached_raster(image.camera_model, self._protocol.pixels).outside_lens

    def image_hash(self, view: RenderView) -> str:
        """Return a hash that changes when the true image changes; the image is not decoded."""
        if self._hidden is not None:
            return hashlib.sha256(_read_hidden(self._hidden, view)).hexdigest()
        _, image = self.recorded_frame_and_image(view)
        return self._hashes.image(image)

    def recorded_frame_and_image(self, view: RenderView) -> tuple[Frame, Image]:
        """Return the recorded frame and image that a view was planned from.

        Raises:
            DatasetError: the dataset does not have the image.
        """
        name = view.traversal_id
        if name not in self._traversals:
            traversal = self._dataset.where(traversal=name)
            numbers: Sequence[int] = traversal.table("frames", ["frame_index"]).column(0).to_pylist()
            positions_by_index = {number: position for position, number in enumerate(numbers)}
            self._traversals[name] = traversal.frames(), positions_by_index
            if len(self._traversals) > _OPEN_TRAVERSALS:
                self._traversals.popitem(last=False)
        self._traversals.move_to_end(name)
        if self._frame is None or (self._frame[0], self._frame[1].frame_index) != (name, view.frame_index):
            frames, positions = self._traversals[name]
            self._frame = name, frames[positions[view.frame_index]]
        frame = self._frame[1]
        image = frame.images.get(view.camera)
        if image is None or image.timestamp_ns != view.timestamp_ns:
            raise DatasetError(
                f"no image of camera {view.camera} at {view.timestamp_ns}",
                file=self._dataset.root,
                place=f"frame {view.frame_index} of {view.traversal_id}",
            )
        return frame, image


def _read_hidden(hidden: Path, view: RenderView) -> bytes:
    path = hidden / view.path
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(
            f"cannot be read: {error.strerror}", file=path, expected="the true image of a moved or edited view"
        ) from error
