"""What a refinement did: per traversal and camera, as values for a person and for a program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from mirror.calibration.refinement.summary import CameraRefinement
from mirror.errors import ExitCode

METHOD: Final = "rig adjustment, 2"
GAUGE: Final = (
    "rotations are relative to the rig's reference camera; its rotation to the vehicle comes from the recorded poses, "
    "and about unobservable axes from the median of the recorded mountings"
)


@dataclass(frozen=True)
class TraversalRefinement:
    """The result of one traversal.

    Attributes:
        traversal_id: the traversal.
        status: ``refined``; ``existing``: it had the layer; ``not refined``: no motion, one frame, nothing matches; or
            ``failed``: data could not be read.
        message: why it has no layer; None: it has one.
        frames: number of frames used.
        images: number of images used.
        unread: messages of images that could not be read.
        cameras: the cameras; empty without a new layer.
    """

    traversal_id: str
    status: str
    message: str | None = None
    frames: int = 0
    images: int = 0
    unread: tuple[str, ...] = ()
    cameras: Sequence[CameraRefinement] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values, for JSON."""
        return {**vars(self), "unread": list(self.unread), "cameras": [one.to_dict() for one in self.cameras]}


@dataclass
class RefinementReport:
    """The result of a refinement of a dataset's calibrations.

    Attributes:
        dataset: path of the dataset.
        layer: ``source@version`` of the layers of calibrations.
        traversals: the results.
        matches: number of matches, by scene.
        steps: number of steps of the adjustment, by scene.
    """

    dataset: str
    layer: str
    traversals: list[TraversalRefinement] = field(default_factory=list)
    matches: dict[str, int] = field(default_factory=dict)
    steps: dict[str, int] = field(default_factory=dict)

    def exit_code(self) -> ExitCode:
        """Return 3 if a traversal has no layer, a camera kept its calibration or an image is unread, else 0."""
        complete = all(
            item.status in ("refined", "existing")
            and not item.unread
            and all(one.status == "refined" for one in item.cameras)
            for item in self.traversals
        )
        return ExitCode.DONE if complete else ExitCode.PARTLY_DONE

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values, for JSON."""
        return {
            "dataset": self.dataset,
            "layer": self.layer,
            "method": METHOD,
            "gauge": GAUGE,
            "matches": self.matches,
            "steps": self.steps,
            "traversals": [item.to_dict() for item in self.traversals],
            "exit_code": int(self.exit_code()),
        }
