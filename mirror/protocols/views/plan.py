"""Which views a protocol asks for, of a dataset and a split: from tables alone, no picture is read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.protocols.document import Frames, Group, Protocol
from mirror.protocols.views.edits import EditPlanner
from mirror.protocols.views.final_camera import final_camera
from mirror.protocols.views.view import RenderView, to_pose_numbers
from mirror.schema.documents import SplitDocument

_MASKS = "masks"


@dataclass(frozen=True)
class Plan:
    """All views of one protocol, dataset and split.

    Attributes:
        protocol: what asks.
        split: the split's name.
        dataset_hash: of what the split was made of.
        layers: those that decide what is scored, ``kind/source@version``, by traversal. Masks that say nothing of road
            users have what they do say before that: ``sky:masks/source@version``.
        views: in order of group, traversal, frame and camera.
        empty_groups: groups whose roles no traversal of the split has, or that found no view.
        hash: SHA-256 of all this but poses and lenses, whose last digits depend on the machine.
    """

    protocol: Protocol
    split: str
    dataset_hash: str
    layers: dict[str, tuple[str, ...]]
    views: tuple[RenderView, ...]
    empty_groups: tuple[str, ...]

    @property
    def hash(self) -> str:
        """See the class."""
        plain = [
            self.protocol.hash,
            self.split,
            self.dataset_hash,
            sorted(self.layers.items()),
            [(view.path, view.width_px, view.height_px) for view in self.views],
        ]
        return hashlib.sha256(json.dumps(plain).encode()).hexdigest()


def plan_views(dataset: Dataset, protocol: Protocol, split: str) -> Plan:
    """The views that a protocol asks for.

    Args:
        dataset: the truth.
        protocol: what is asked.
        split: name of a split of the dataset.

    Raises:
        DatasetError: no such split, or no traversal has a role that is asked for; poses or calibrations are missing;
            traversals have nothing to mask road users by.
        UsageError: a camera that the protocol names is in no traversal.
    """
    document = dataset.store.json(f"splits/{split}.json", SplitDocument) if _has(dataset, split) else None
    if document is None:
        raise DatasetError(
            "no such split",
            file=dataset.store.full_path(f"splits/{split}.json"),
            remedy=f"make it: mirror split {dataset.root} {split}",
        )
    views: list[RenderView] = []
    empty = []
    editor = EditPlanner(protocol)
    for group in protocol.groups:
        own = list(_of_group(dataset, protocol, split, document, group, editor))
        views += own
        if not own:
            empty.append(group.name)
    if not views and protocol.task not in ("annotation", "runtime"):
        roles = sorted({role for group in protocol.groups for role in group.roles})
        raise DatasetError(
            f"protocol {protocol.name} finds no picture to ask for",
            file=dataset.root,
            place=f"split {split}",
            expected=f"traversals with pictures in the roles {', '.join(roles)}",
            remedy="choose another split or protocol",
        )
    layers = _layers(dataset, protocol, sorted({view.traversal_id for view in views}))
    _require_maskable(dataset, protocol, layers)
    return Plan(protocol, split, document.dataset_hash, layers, tuple(views), tuple(empty))


def render_path(group: str, traversal_id: str, camera: str, timestamp_ns: int) -> str:
    """Where a render lies in a submission.

    Raises:
        DatasetError: a name of the dataset cannot be part of a path.
    """
    for name in (traversal_id, camera):
        if name in ("", ".", "..") or PurePosixPath(name).name != name or "\\" in name:
            raise DatasetError(f"the name {name!r} cannot be a folder", expected="no slash and no `..`")
    return f"renders/{group}/{traversal_id}/{camera}/{timestamp_ns}.png"


def select_frames(count: int, frames: Frames) -> list[int]:
    """Positions of the frames that are rendered, of so many."""
    positions = range(frames.first, count, frames.every)
    return sorted({*positions, *([count - 1] if frames.last and count else [])})


def _has(dataset: Dataset, split: str) -> bool:
    return f"{split}.json" in dataset.store.list_files("splits")


def _of_group(
    dataset: Dataset, protocol: Protocol, split: str, document: SplitDocument, group: Group, editor: EditPlanner
) -> Iterator[RenderView]:
    if not set(group.roles) & set(document.assignments.values()):
        return
    view = dataset.where(split=split, role=group.roles)
    if protocol.frames.cameras is not None:
        view = view.where(camera=protocol.frames.cameras)
    table = view.table("traversals", ["traversal_id", "light", "weather"]).to_pylist()
    finals: dict[Camera, Camera] = {}
    for row in table:
        frames = view.where(traversal=row["traversal_id"]).frames()
        for position in select_frames(len(frames), protocol.frames):
            frame = frames[position]
            for image in frame.images.values():
                camera = image.camera_model
                if camera not in finals:
                    finals[camera] = final_camera(camera, protocol.pixels)
                one = _view(group, frame, image, finals[camera], row, editor)
                if one is not None:
                    yield one


def _view(
    group: Group, frame: Frame, image: Image, camera: Camera, row: dict[str, str], editor: EditPlanner
) -> RenderView | None:
    pose = image.world_SE3_camera
    if group.ego_shift_m:
        ego_SE3_camera = image.calibration.ego_SE3_camera
        aside = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, group.ego_shift_m, 0.0]]))
        pose = pose @ ego_SE3_camera.inverse() @ aside @ ego_SE3_camera
    edits = editor.edits(group, frame, image.camera, camera, pose)
    if edits is None:
        return None
    return RenderView(
        path=render_path(group.name, frame.traversal_id, image.camera, image.timestamp_ns),
        group=group.name,
        scene_id=frame.scene_id,
        traversal_id=frame.traversal_id,
        frame_index=frame.frame_index,
        camera=image.camera,
        timestamp_ns=image.timestamp_ns,
        light=row["light"],
        weather=row["weather"],
        model=camera.model,
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.fx_px,
        fy_px=camera.fy_px,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
        distortion=camera.distortion,
        world_SE3_camera=to_pose_numbers(pose),
        edits=edits,
    )


def _layers(dataset: Dataset, protocol: Protocol, traversals: list[str]) -> dict[str, tuple[str, ...]]:
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    wanted, told = set(traversals), _kinds_of_masks(dataset)
    asked = {kind for kind, read in (("ego", protocol.masks.ego), ("sky", protocol.masks.sky)) if read}
    found = {}
    for row in rows:
        if row["traversal_id"] not in wanted:
            continue
        own = [layer for layer in row["layers"] if layer.startswith("boxes/")]
        for layer in row["layers"]:
            if layer.startswith(f"{_MASKS}/"):
                kinds = told.get((row["traversal_id"], layer))
                # A layer without rows was made, and found no road user.
                if kinds is None or "dynamic" in kinds:
                    own.append(layer)
                else:
                    own += [f"{kind}:{layer}" for kind in kinds & asked]
        found[row["traversal_id"]] = tuple(sorted(own))
    return found


def _kinds_of_masks(dataset: Dataset) -> dict[tuple[str, str], set[str]]:
    """What the layers of masks mask, by traversal and layer."""
    names = ["traversal_id", "source", "source_version", "kind"]
    found: dict[tuple[str, str], set[str]] = {}
    for row in dataset.table(_MASKS, names).group_by(names).aggregate([]).to_pylist():
        layer = f"{_MASKS}/{row['source']}@{row['source_version']}"
        found.setdefault((row["traversal_id"], layer), set()).add(row["kind"])
    return found


def _require_maskable(dataset: Dataset, protocol: Protocol, layers: dict[str, tuple[str, ...]]) -> None:
    kinds = set(protocol.masks.dynamic)
    if not kinds:
        return
    bare = [key for key, own in layers.items() if not kinds & {one.partition("/")[0] for one in own}]
    if bare:
        raise DatasetError(
            f"{len(bare)} traversals have nothing to mask road users by, such as {bare[0]}",
            file=dataset.root,
            expected=f"layers of kind {' or '.join(sorted(kinds))}",
            remedy="annotate them, or score everything with a protocol of your own: --protocol FILE.toml with "
            "dynamic = [] under [masks] (its figures are comparable only with its own)",
        )


def find_group(protocol: Protocol, name: str) -> Group:
    """A protocol's group by name.

    Raises:
        UsageError: it has none of that name.
    """
    for group in protocol.groups:
        if group.name == name:
            return group
    raise UsageError(f"no group {name!r}", expected=f"one of {', '.join(one.name for one in protocol.groups)}")
