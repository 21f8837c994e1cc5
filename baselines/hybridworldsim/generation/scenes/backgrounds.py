"""Backgrounds of generated frames: a static model, the exact synthetic street, or files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import cv2
import numpy as np

from mirror.arrays import Int64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.devices import Device, choose_device
from mirror.errors import DatasetError, UsageError
from mirror.geometry.poses import Poses
from mirror.protocols.png import HEADER_BYTES, png_size
from mirror.protocols.views.view import RenderView
from mirror.synth import parse_public_seed
from mirror.weights.resolve import file_sha256

if TYPE_CHECKING:
    from mirror.synth import SynthDrive

Background: TypeAlias = Callable[[RenderView], UInt8]
"""From a view to the image (H, W, 3) of the street without road users, in the view's raster."""
_SAME_PLACE_M: Final = 5.0
"""Farther than the recorded position of a vehicle is wrong by; another seed or preset has it elsewhere."""


def open_background(
    text: str, dataset: Dataset, appearance: str, views: Sequence[RenderView], method: str | None = None
) -> tuple[Background, str]:
    """Open the source of backgrounds that a command-line option names.

    Args:
        text: folder that `mirror reconstruct` wrote; ``exact:PRESET`` or ``exact:PRESET:SEED`` for the synthetic street
            without road users; or ``files:FOLDER`` with ``<camera>/<timestamp_ns>.png``.
        dataset: dataset of the views.
        appearance: appearance of a static model, such as ``night``.
        views: all views, so that an appearance can be chosen by the driven line.
        method: ``FILE.py:OBJECT`` of a static model's method; None: it is installed.

    Returns:
        The source, and a hash or name of everything that its images depend on.

    Raises:
        UsageError: the text is none of these, the dataset is not of the preset and seed, the model's method cannot be
            loaded, or an appearance or a method is named for a source that is no model.
        DatasetError: the model or the files do not fit the views.
    """
    kind, colon, rest = text.partition(":")
    if kind in ("exact", "files") and colon:
        if appearance != "nearest":
            raise UsageError(f"{appearance!r}", place="--appearance", expected="a static model as background")
        if method is not None:
            raise UsageError(f"{method!r}", place="--method", expected="a static model as background")
        if kind == "files":
            files = _Files(Path(rest), views)
            return files, f"{text} sha256 {files.sha256}"
        preset, _, seed = rest.partition(":")
        if not preset:
            raise UsageError(f"{text!r}", place="--background", expected="exact:PRESET or exact:PRESET:SEED")
        _require_preset(preset)
        street = _ExactStreet(dataset, preset, parse_public_seed(seed or "0", "--background"))
        street.require_drives(views)
        return street, text
    return _open_model(Path(text), dataset, appearance, views, method)


def choose_background_device(texts: Sequence[str], requested: str, method: str | None = None) -> Device:
    """Choose the device that renders backgrounds: on a GPU only if all are models that can render there.

    Args:
        texts: as in `open_background`.
        requested: the value of ``--device``.
        method: ``FILE.py:OBJECT`` of the static models' method; None: it is installed.

    Raises:
        UsageError: there is no such device, or a background cannot be rendered on it.
        DatasetError: a background is a folder without a model.
    """
    from mirror.methods.model import ModelFolder

    if not texts:
        return choose_device(requested, "no background", takes_device=False)
    for text in texts:
        kind, colon, _ = text.partition(":")
        if kind in ("exact", "files") and colon:
            return choose_device(requested, f"--background {text}", takes_device=False)
    devices = [ModelFolder.read(Path(text), method).choose_device(requested) for text in texts]
    return next((device for device in devices if not device.is_cuda), devices[0])


def calibrations_of(text: str) -> str:
    """Return the layer of calibrations of a source of backgrounds; of a model, the layer of its training.

    Args:
        text: as in `open_background`.

    Raises:
        DatasetError: there is no such model.
    """
    from mirror.methods.model_document import read_reconstruction

    kind, colon, _ = text.partition(":")
    if kind in ("exact", "files") and colon:
        return "recorded"
    return read_reconstruction(Path(text)).calibrations


def _open_model(
    folder: Path, dataset: Dataset, appearance: str, views: Sequence[RenderView], method: str | None
) -> tuple[Background, str]:
    from mirror.methods.appearance import AppearancePolicy, require_known_appearance
    from mirror.methods.model import ModelFolder
    from mirror.methods.model_document import DOCUMENT, read_reconstruction, require_matching_split

    document = read_reconstruction(folder)
    require_matching_split(dataset, document.split, document)
    require_known_appearance(appearance, dataset, document.trained)
    scenes = sorted({view.scene_id for view in views})
    if scenes != [document.scene]:
        raise UsageError(
            f"the static model is of scene {document.scene}", place="--background", expected=f"of {', '.join(scenes)}"
        )
    policy = AppearancePolicy(appearance, views, everywhere=True)
    return ModelFolder.read(folder, method).open(policy), file_sha256(folder / DOCUMENT)


def _require_preset(preset: str) -> None:
    from mirror.synth import PRESETS

    if preset not in PRESETS:
        raise UsageError(
            f"no preset {preset!r}", place="--background", expected=f"exact: with one of {', '.join(PRESETS)}"
        )


class _Files:
    """Backgrounds in files, in the rasters of the views that they are opened for; other rasters are scaled from them.

    Attributes:
        sha256: hash of all files of the views.

    Raises:
        DatasetError: a file is missing, or its image has another size than its view.
    """

    def __init__(self, folder: Path, views: Sequence[RenderView]) -> None:
        if not folder.is_dir():
            raise DatasetError(
                "no such folder of backgrounds", file=folder, place="--background",
                expected="<camera>/<timestamp_ns>.png in it",
            )  # fmt: skip
        self._folder = folder
        digest = hashlib.sha256()
        for view in views:
            file = self._file(view)
            if not file.is_file():
                raise self._error("no background image", view)
            with file.open("rb") as stream:
                size = png_size(stream.read(HEADER_BYTES))
            if size != (view.width_px, view.height_px):
                found = "no PNG" if size is None else f"a background of {size[0]} x {size[1]} px"
                raise self._error(found, view)
            digest.update(f"{view.camera} {view.timestamp_ns} {file_sha256(file)}\n".encode())
        self.sha256 = digest.hexdigest()

    def _file(self, view: RenderView) -> Path:
        return self._folder / view.camera / f"{view.timestamp_ns}.png"

    def _error(self, problem: str, view: RenderView) -> DatasetError:
        return DatasetError(
            problem,
            file=self._file(view),
            place=f"camera {view.camera}, timestamp_ns {view.timestamp_ns}",
            expected=f"a PNG of {view.width_px} x {view.height_px} px",
            remedy="add it, or name another --background",
        )

    def __call__(self, view: RenderView) -> UInt8:
        image = cv2.imread(str(self._file(view)), cv2.IMREAD_COLOR)
        if image is None:
            raise self._error("a background that cannot be read", view)
        if image.shape[:2] != (view.height_px, view.width_px):
            image = cv2.resize(image, (view.width_px, view.height_px), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(image[..., ::-1])


class _ExactStreet:
    """The synthetic street without road users, from the true pose of the recording vehicle."""

    def __init__(self, dataset: Dataset, preset: str, seed: int) -> None:
        rows = dataset.table("traversals", ["traversal_id", "drive_id"]).to_pylist()
        self._drives = {row["traversal_id"]: row["drive_id"] for row in rows}
        self._dataset, self._preset, self._seed = dataset, preset, seed
        self._tracks: dict[str, tuple[Int64, Poses]] = {}

    def require_drives(self, views: Sequence[RenderView]) -> None:
        """Require that the drives of the views are those of the preset with this seed.

        Raises:
            UsageError: the preset has no such drive, or its vehicle was elsewhere at the first or last frame.
        """
        for traversal_id in dict.fromkeys(view.traversal_id for view in views):
            name = self._drives[traversal_id]
            try:
                drive = _drive(self._preset, self._seed, name)
            except UsageError as error:
                raise self._not_of_preset(name, "it has no such drive") from error
            frames = self._dataset.where(traversal=traversal_id).frames()
            stamps = np.array([frames[0].timestamp_ns, frames[-1].timestamp_ns])
            ways = drive.world_SE3_ego(stamps).translation - self._recorded(traversal_id, stamps).translation
            far_m = float(np.linalg.norm(ways, axis=1).max())
            if not far_m <= _SAME_PLACE_M:
                raise self._not_of_preset(name, f"its vehicle is {far_m:.0f} m from the recorded place")

    def _not_of_preset(self, drive: str, problem: str) -> UsageError:
        return UsageError(
            f"drive {drive!r} is not of preset {self._preset!r} with seed {self._seed}: {problem}",
            place="--background", expected="exact:PRESET:SEED of the dataset, as `mirror synth` was given them",
        )  # fmt: skip

    def _recorded(self, traversal_id: str, timestamp_ns: Int64) -> Poses:
        """Return the recorded poses (N,) of the vehicle at Unix times (N,)."""
        from mirror.geometry.interpolation import interpolate

        if traversal_id not in self._tracks:
            # Every view of a traversal needs its poses: they are read once.
            self._tracks[traversal_id] = self._dataset.where(traversal=traversal_id).frames()[0].track
        return interpolate(*self._tracks[traversal_id], timestamp_ns)

    def __call__(self, view: RenderView) -> UInt8:
        drive, empty = _empty_street(self._preset, self._seed, self._drives[view.traversal_id])
        recorded = self._recorded(view.traversal_id, np.array([view.timestamp_ns]))
        # What the view adds to the recorded pose is kept; the recorded pose is replaced by the true one.
        world_SE3_camera = drive.world_SE3_ego(np.array([view.timestamp_ns])) @ recorded.inverse() @ view.pose
        lens = _lens(view.lens)
        instant = empty.around(float(drive.seconds(np.array([view.timestamp_ns]))[0]), world_SE3_camera.translation[0])
        # The camera's own response, so that the background has the tones of the recorded images.
        rendered = empty.render(instant, lens, world_SE3_camera, response=drive.camera_responses[view.camera])
        return np.ascontiguousarray(rendered.bgr[..., ::-1])


@lru_cache(16)
def _drive(preset: str, seed: int, drive_id: str) -> SynthDrive:
    from mirror.synth import make_drive

    return make_drive(preset, seed, drive_id)


@lru_cache(4)
def _empty_street(preset: str, seed: int, drive_id: str) -> tuple[SynthDrive, Any]:
    from mirror.synth import Model, Scene

    drive = _drive(preset, seed, drive_id)
    return drive, Scene(drive.world, drive.condition, (), Model.empty(), clock_s=drive.truth.clock_s)


@lru_cache(16)
def _lens(camera: Any) -> Any:
    from mirror.synth import make_lens

    return make_lens(camera)
