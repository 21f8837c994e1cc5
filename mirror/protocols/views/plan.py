"""Plans: the views that a protocol requests for a dataset and a split. Only tables are read, no images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from mirror.counting import count_of
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.redaction import REDACTION
from mirror.dataset.split_document import read_split
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.protocols.document import Frames, Group, Protocol, protocol_names
from mirror.protocols.views.edits import EditPlanner
from mirror.protocols.views.final_camera import final_camera
from mirror.protocols.views.rolling import plan_shutter
from mirror.protocols.views.view import RenderView
from mirror.schema.documents import SplitDocument
from mirror.schema.hashing import hash_document

_MASKS = "masks"


@dataclass(frozen=True)
class Plan:
    """All views of one protocol, dataset and split.

    Attributes:
        protocol: the protocol.
        split: name of the split.
        dataset_hash: hash of the dataset that the split was made from.
        layers: layers that affect the scored mask, ``kind/source@version``, by traversal. A layer of masks without the
            kind ``dynamic`` has its kind as a prefix: ``sky:masks/source@version``.
        views: requested views, ordered by group, traversal, frame and camera.
        empty_groups: groups without a view.
        hash: SHA-256 of the above without poses and lenses, because their last digits depend on the machine.
    """

    protocol: Protocol
    split: str
    dataset_hash: str
    layers: dict[str, tuple[str, ...]]
    views: tuple[RenderView, ...]
    empty_groups: tuple[str, ...]

    @property
    def hash(self) -> str:
        """SHA-256 of the plan without poses and lenses."""
        rolling = sorted({(view.camera, view.shutter.direction) for view in self.views if view.shutter is not None})
        plain = [
            self.protocol.hash,
            self.split,
            self.dataset_hash,
            sorted(self.layers.items()),
            [(view.path, view.width_px, view.height_px) for view in self.views],
            # absent without rolling shutters, so that the hashes of plans without them stay
            *([rolling] if rolling else []),
        ]
        return hash_document(plain)


def plan_views(dataset: Dataset, protocol: Protocol, split: str, *, calibrated_shutters: bool = False) -> Plan:
    """Plan the views that a protocol requests.

    Args:
        dataset: dataset with the truth.
        protocol: the protocol.
        split: name of a split of the dataset.
        calibrated_shutters: give views the shutter of their calibration, as the protocol may state, whatever it states.

    Raises:
        DatasetError: the split does not exist; no traversal has a requested role; poses or calibrations are missing;
            or traversals have no layer to mask road users with.
        UsageError: no traversal has a camera that the protocol names, the protocol scores rollouts, or the name cannot
            be that of a split.
    """
    if protocol.task == "safety":
        raise UsageError(
            f"protocol {protocol.name} scores rollouts of a policy, not renders of a dataset",
            place="--protocol",
            remedy=f"drive the scenarios with `mirror simulate`, then: mirror evaluate RUN --protocol {protocol.name}",
        )
    document = read_split(dataset.store, split)
    views: list[RenderView] = []
    empty = []
    editor, finals = EditPlanner(protocol), dict[Camera, Camera]()
    for group in protocol.groups:
        group_views = list(_plan_group(dataset, protocol, split, document, group, editor, finals, calibrated_shutters))
        views += group_views
        if not group_views:
            empty.append(group.name)
    if not views and protocol.task not in ("annotation", "runtime"):
        roles = sorted({role for group in protocol.groups for role in group.roles})
        raise DatasetError(
            f"protocol {protocol.name} requests no image of this dataset",
            file=dataset.root,
            place=f"split {split}",
            expected=f"traversals with images in the roles {', '.join(roles)}",
            remedy="choose another split or protocol",
        )
    layers = _find_layers(dataset, protocol, sorted({view.traversal_id for view in views}))
    _require_maskable(dataset, protocol, layers)
    return Plan(protocol, split, document.dataset_hash, layers, tuple(views), tuple(empty))


def render_path(group: str, traversal_id: str, camera: str, timestamp_ns: int) -> str:
    """Return the path of a render in a submission.

    Raises:
        DatasetError: the traversal's or camera's name cannot be part of a path.
    """
    for name in (traversal_id, camera):
        if name in ("", ".", "..") or PurePosixPath(name).name != name or "\\" in name:
            raise DatasetError(f"the name {name!r} cannot be a folder", expected="no slash and no `..`")
    return f"renders/{group}/{traversal_id}/{camera}/{timestamp_ns}.png"


def select_frames(count: int, frames: Frames) -> list[int]:
    """Select the indices of the rendered frames among `count` frames, ascending."""
    positions = range(frames.first, count, frames.every)
    return sorted({*positions, *([count - 1] if frames.last and count else [])})


def _plan_group(
    dataset: Dataset,
    protocol: Protocol,
    split: str,
    document: SplitDocument,
    group: Group,
    editor: EditPlanner,
    finals: dict[Camera, Camera],
    calibrated_shutters: bool,
) -> Iterator[RenderView]:
    rolls = calibrated_shutters or protocol.pixels.shutter == "calibrated"
    if not set(group.roles) & set(document.assignments.values()):
        return
    selected = dataset.where(split=split, role=group.roles)
    if protocol.frames.cameras is not None:
        selected = selected.where(camera=protocol.frames.cameras)
    table = selected.table("traversals", ["traversal_id", "light", "weather"]).to_pylist()
    for row in table:
        frames = selected.where(traversal=row["traversal_id"]).frames()
        for position in select_frames(len(frames), protocol.frames):
            frame = frames[position]
            for image in frame.images.values():
                camera = image.camera_model
                if camera not in finals:
                    finals[camera] = final_camera(camera, protocol.pixels)
                view = _plan_view(group, frame, image, finals[camera], row, editor, rolls)
                if view is not None:
                    yield view


def _plan_view(
    group: Group, frame: Frame, image: Image, camera: Camera, row: dict[str, str], editor: EditPlanner, rolls: bool
) -> RenderView | None:
    pose, moved = image.world_SE3_camera, None
    if group.ego_shift_m:
        ego_SE3_camera = image.calibration.ego_SE3_camera
        shift = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, group.ego_shift_m, 0.0]]))
        moved = ego_SE3_camera.inverse() @ shift @ ego_SE3_camera
        pose = pose @ moved
    edits = editor.plan_edits(group, frame, image.camera, camera, pose)
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
        **camera.to_row(),
        world_SE3_camera=pose,
        edits=edits,
        shutter=plan_shutter(image, camera, moved) if rolls else None,
    )


def _find_layers(dataset: Dataset, protocol: Protocol, traversals: list[str]) -> dict[str, tuple[str, ...]]:
    """The layers of each traversal that affect the scored mask; see `Plan.layers`."""
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    kinds_by_layer = _find_mask_kinds(dataset)
    masked_kinds = {kind for kind, is_masked in (("ego", protocol.masks.ego), ("sky", protocol.masks.sky)) if is_masked}
    masked_kinds.add(REDACTION)
    layers_by_traversal = {}
    for row in rows:
        if row["traversal_id"] not in traversals:
            continue
        layers = [layer for layer in row["layers"] if layer.startswith("boxes/")]
        for layer in row["layers"]:
            if layer.startswith(f"{_MASKS}/"):
                kinds = kinds_by_layer.get((row["traversal_id"], layer))
                # A layer without rows has masks in which no road user was found.
                if kinds is None or "dynamic" in kinds:
                    layers.append(layer)
                else:
                    layers += [f"{kind}:{layer}" for kind in kinds & masked_kinds]
        layers_by_traversal[row["traversal_id"]] = tuple(sorted(layers))
    return layers_by_traversal


def _find_mask_kinds(dataset: Dataset) -> dict[tuple[str, str], set[str]]:
    """The kinds of masks in each layer of masks, by traversal and layer."""
    kinds: dict[tuple[str, str], set[str]] = {}
    table = dataset.table(_MASKS, ["traversal_id", "source", "source_version", "kind"])
    # `Table.group_by` would import pandas, which takes longer than a plan of a thousand views.
    for traversal, source, version, kind in set(zip(*(column.to_pylist() for column in table.columns))):
        kinds.setdefault((traversal, f"{_MASKS}/{source}@{version}"), set()).add(kind)
    return kinds


def _require_maskable(dataset: Dataset, protocol: Protocol, layers: dict[str, tuple[str, ...]]) -> None:
    kinds = set(protocol.masks.dynamic)
    if not kinds:
        return
    without = [name for name, own in layers.items() if not kinds & {layer.partition("/")[0] for layer in own}]
    if without:
        raise DatasetError(
            f"{count_of(len(without), 'traversal')} with no layer to mask road users with, such as {without[0]}",
            file=dataset.root,
            expected=f"layers of kind {' or '.join(sorted(kinds))}",
            remedy="annotate them: `mirror annotate DATASET --annotator NAME`; or train on road users and score them: "
            f"{_how_to_unmask(protocol)} (figures are comparable only with those of the same protocol)",
        )


def _how_to_unmask(protocol: Protocol) -> str:
    """The options that choose a protocol without masks."""
    unmasked = f"{protocol.name}-unmasked"
    if unmasked in protocol_names():
        return f"--protocol {unmasked}"
    return "--protocol FILE.toml with dynamic = [] under [masks], as `mirror protocols show` prints one"


def find_group(protocol: Protocol, name: str) -> Group:
    """Find a protocol's group by its name.

    Raises:
        UsageError: the protocol has no group of that name.
    """
    for group in protocol.groups:
        if group.name == name:
            return group
    raise UsageError(f"no group {name!r}", expected=f"one of {', '.join(group.name for group in protocol.groups)}")
