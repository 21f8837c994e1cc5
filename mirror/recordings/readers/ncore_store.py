"""The component stores of an NCore sequence, read through the package ``nvidia-ncore``.

Stored codecs name functions that decode bytes, and one of them unpickles: images and masks are read only if they are
stored as they are, without a codec. Everything else that is read here is JSON.
"""

from __future__ import annotations

import lzma
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import Float64, Int64, UInt8
from mirror.errors import RecordingError
from mirror.installation import install_command
from mirror.recordings.opening import unreadable_error
from mirror.recordings.readers.stored_poses import REMEDY

if TYPE_CHECKING:
    from ncore.data.v4 import SequenceComponentGroupsReader

DEFAULT: Final = "default"
_LAST_US: Final = 9_000_000_000_000_000
# What the package and those below it raise on damaged stores; its checks of input are assertions.
_BROKEN: Final[tuple[type[Exception], ...]] = (
    AssertionError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError, RuntimeError, OSError,
    EOFError, MemoryError, SyntaxError, lzma.LZMAError, struct.error,
)  # fmt: skip
Edge = tuple[str, str]


@contextmanager
def store_errors(store: Path) -> Iterator[None]:
    """Turn the errors of damaged stores into errors that name the store.

    Raises:
        RecordingError: in place of the package's exceptions.
    """
    try:
        yield
    except RecordingError:
        raise
    except _BROKEN + _library_errors() as error:
        raise unreadable_error(store, error) from error


def _library_errors() -> tuple[type[Exception], ...]:
    """Errors of the libraries below the package, which are imported with it."""
    from cbor2 import CBORError
    from zarr.errors import MetadataError

    return CBORError, MetadataError


@dataclass(frozen=True)
class CuboidObservation:
    """One observation of an object: a box in a named frame at a stamp.

    Attributes:
        track_id: the object.
        class_id: its class.
        timestamp_us: the instant that the box describes.
        frame: the frame of the box.
        frame_us: the instant of that frame.
        box: (9,) centre, length, width, height, and rotations about the fixed axes x, y, z in this order.
        source: how the label was made, in small letters.
        version: of that source.
    """

    track_id: str
    class_id: str
    timestamp_us: int
    frame: str
    frame_us: int
    box: Float64
    source: str
    version: str


@dataclass(frozen=True)
class NcoreStores:
    """The stores of one sequence.

    Attributes:
        paths: files ``*.zarr.itar`` and folders ``*.zarr``.
        instances: the instance to take of each kind of component; ``default``, or the only one, if a kind is absent.
    """

    paths: tuple[Path, ...]
    instances: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def _opened(self) -> dict[Any, dict[str, tuple[Path, Any]]]:
        """The components that were opened, by their kind."""
        return {}

    @cached_property
    def _readers(self) -> list[tuple[Path, SequenceComponentGroupsReader]]:
        try:
            from ncore.data.v4 import SequenceComponentGroupsReader
        except ImportError as error:
            raise RecordingError(
                "NCore sequences need the package nvidia-ncore, which is not installed",
                file=self.paths[0],
                remedy=install_command("ncore"),
            ) from error
        readers = []
        for path in self.paths:
            with store_errors(path):
                readers.append((path, SequenceComponentGroupsReader([path], max_threads=1)))
        first = readers[0][1].sequence_id
        for path, reader in readers:
            if not isinstance(reader.sequence_id, str) or reader.sequence_id != first:
                raise RecordingError(
                    f"the store belongs to sequence {reader.sequence_id!r:.80}, another one to {first!r:.80}",
                    file=path,
                    expected="stores of one sequence with one name before .ncore4",
                    remedy="move it to a folder of its own",
                )
        return readers

    @property
    def sequence_id(self) -> str:
        """The sequence's id."""
        return str(self._readers[0][1].sequence_id)

    def _components(self, kind: Any) -> dict[str, tuple[Path, Any]]:
        """Components of one kind by the name of their instance, with their stores."""
        if kind in self._opened:
            return self._opened[kind]
        found: dict[str, tuple[Path, Any]] = {}
        for path, reader in self._readers:
            with store_errors(path):
                for name, component in reader.open_component_readers(kind).items():
                    if name in found:
                        raise RecordingError(
                            f"the component {name!r:.80} is also in {found[name][0].name}",
                            file=path,
                            expected="each component once",
                            remedy="move one of the stores elsewhere",
                        )
                    found[name] = path, component
        self._opened[kind] = found
        return found

    def _choose(self, what: str, kind: Any) -> tuple[Path, Any] | None:
        components = self._components(kind)
        wanted = self.instances.get(what)
        if wanted is None:
            wanted = min(components) if len(components) == 1 else DEFAULT if DEFAULT in components else ""
        if wanted in components:
            return components[wanted]
        if not components and what not in self.instances:
            return None
        none = f"the sequence has no {what} of the name {wanted!r:.80}"
        raise RecordingError(
            none if wanted else f"the sequence has several {what}, none of them {DEFAULT}",
            file=self.paths[0].parent,
            expected=f"one of {', '.join(sorted(components))}" if components else f"a component of {what}",
            remedy=f"name one: --option {what}=NAME",
        )

    @cached_property
    def _poses(self) -> tuple[Path, Any]:
        from ncore.data.v4 import PosesComponent

        found = self._choose("poses", PosesComponent.Reader)
        if found is None:
            raise RecordingError("no store has poses", file=self.paths[0], expected="a component poses", remedy=REMEDY)
        return found

    @property
    def poses_path(self) -> Path:
        """The store of the poses."""
        return self._poses[0]

    @cached_property
    def static_poses(self) -> dict[Edge, Float64]:
        """(4, 4) matrices by ``(source, target)``: each maps points of the source frame into the target frame."""
        path, reader = self._poses
        with store_errors(path):
            return {edge: np.array(pose, np.float64).reshape(4, 4) for edge, pose in reader.get_static_poses()}

    def trajectory(self, source: str, target: str) -> tuple[Int64, Float64]:
        """Return the stamps (N,) in microseconds and matrices (N, 4, 4) of a frame that moves in another frame.

        Raises:
            RecordingError: there is none, or it cannot be read.
        """
        path, reader = self._poses
        with store_errors(path):
            for edge, (matrices, stamps) in reader.get_dynamic_poses():
                if edge == (source, target):
                    if len(matrices) != len(stamps):
                        raise ValueError(f"{len(matrices)} poses at {len(stamps)} stamps")
                    known = np.array(stamps, np.uint64) <= _LAST_US
                    us = np.where(known, stamps, np.iinfo(np.int64).max).astype(np.int64)
                    return us, np.array(matrices, np.float64).reshape(-1, 4, 4)
        raise RecordingError(
            f"no poses of {source} in {target}",
            file=path,
            expected=f"the dynamic pose ({source!r}, {target!r})",
            remedy="convert the sequence again, with the vehicle's trajectory",
        )

    @cached_property
    def _cameras(self) -> dict[str, tuple[Path, Any]]:
        from mirror.recordings.readers.ncore_images import ImageReader

        return self._components(ImageReader)

    @cached_property
    def frames_us(self) -> dict[str, Int64]:
        """(N, 2) start and end of the frames of each camera, in microseconds."""
        frames = {}
        for name, (path, reader) in sorted(self._cameras.items()):
            with store_errors(path):
                stamps = np.array(reader.frames_timestamps_us, np.uint64).reshape(-1, 2)
                if (stamps > _LAST_US).any() or (stamps[:, 1] < stamps[:, 0]).any():
                    raise ValueError("a frame that ends before it starts, or after the year 2255")
                if len(stamps):
                    frames[name] = stamps.astype(np.int64)
        return frames

    def camera_path(self, camera: str) -> Path:
        """Return the store of a camera's images."""
        return self._cameras[camera][0]

    def image_format(self, camera: str, end_us: int) -> str:
        """Return ``jpeg`` or ``png``: the format of the frame that ends at a stamp."""
        path, reader = self._cameras[camera]
        with store_errors(path):
            return str(reader.image_format(end_us))

    def image(self, camera: str, end_us: int) -> bytes:
        """Return the encoded image of the frame that ends at a stamp."""
        path, reader = self._cameras[camera]
        with store_errors(path):
            return bytes(reader.image(end_us, path))

    def lens(self, camera: str) -> tuple[Path, Any]:
        """Return the store and the ``CameraModelParameters`` of a camera.

        Raises:
            RecordingError: the sequence has no intrinsics of this camera.
        """
        from ncore.data.v4 import IntrinsicsComponent

        found = self._choose("intrinsics", IntrinsicsComponent.Reader)
        if found is None:
            raise RecordingError(
                "no store has intrinsics", file=self.paths[0], expected="a component intrinsics", remedy=REMEDY
            )
        path, reader = found
        with store_errors(path):
            return path, reader.get_camera_model_parameters(camera)

    def ego_mask(self, camera: str) -> UInt8 | None:
        """Return the mask (H, W), non-zero where the image shows the vehicle.

        None: the sequence has no mask ``ego`` of the camera.
        """
        from mirror.recordings.readers.ncore_images import MaskReader

        found = self._choose("masks", MaskReader)
        if found is None:
            return None
        path, reader = found
        with store_errors(path):
            return reader.ego_mask(camera, path)

    def observations(self) -> Sequence[CuboidObservation] | None:
        """Return all boxes; None if the sequence has none."""
        from ncore.data.v4 import CuboidsComponent

        found = self._choose("cuboids", CuboidsComponent.Reader)
        if found is None:
            return None
        path, reader = found
        with store_errors(path):
            return [
                CuboidObservation(
                    track_id=one.track_id,
                    class_id=one.class_id,
                    timestamp_us=one.timestamp_us,
                    frame=one.reference_frame_id,
                    frame_us=one.reference_frame_timestamp_us,
                    box=np.array([*one.bbox3.centroid, *one.bbox3.dim, *one.bbox3.rot], np.float64),
                    source=one.source.name.lower(),
                    version=one.source_version or "v4",
                )
                for one in reader.get_observations()
            ]

    def cuboids_path(self) -> Path:
        """Return the store of the boxes; without boxes, the store of the poses."""
        from ncore.data.v4 import CuboidsComponent

        found = self._choose("cuboids", CuboidsComponent.Reader)
        return self.poses_path if found is None else found[0]
