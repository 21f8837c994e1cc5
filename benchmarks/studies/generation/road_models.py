"""Roads of the study as a user would have them: recorded, ingested, and reconstructed by `mirror reconstruct`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

import mirror
from benchmarks.studies.generation.backgrounds import render_backgrounds
from benchmarks.studies.generation.make_clips import BUSTLE, PRESET
from benchmarks.studies.generation.recordings import write_recording, write_region
from benchmarks.studies.generation.street_clips import StreetRig, busy_drive
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.training.documents import TrainingOutcome
from hybridworldsim.training.run.folder import RunFolder
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.geometry import Poses
from mirror.geometry.interpolation import interpolate
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model_document import read_reconstruction
from mirror.methods.registry import installed_method
from mirror.protocols.views.view import RenderView
from mirror.synth.fleet.drive import SynthDrive

SPLIT: Final = "all"
_AGREE_M: Final = 0.01


@dataclass(frozen=True)
class Road:
    """The declaration of a road: its routes, recordings and reconstruction.

    Attributes:
        name: its name, which is the id of its scene.
        routes: drives of the preset that begin on it.
        stretch_m: metres from their beginning that are recorded.
        recordings: seeds, distance of images, and their size.
        reconstruction: options of `mirror reconstruct`.
        factor: renders are so many times larger than clips.
        preset: preset of the routes.
        bustle: density of the traffic.
    """

    name: str
    routes: Sequence[str]
    stretch_m: float
    recordings: Mapping[str, Any]
    reconstruction: Mapping[str, Any]
    factor: int
    preset: str = PRESET
    bustle: float = BUSTLE


class RoadModel:
    """The recordings, the dataset and the model of a road, in a folder. Every part continues where it stopped.

    Args:
        road: the road.
        folder: its folder.
    """

    def __init__(self, road: Road, folder: Path) -> None:
        self.road, self.folder = road, folder

    @property
    def model(self) -> Path:
        """Folder of the model."""
        return self.folder / "model"

    @cached_property
    def dataset(self) -> Dataset:
        """The dataset of the recordings."""
        return mirror.open(self.folder / "dataset")

    def record(self) -> dict[str, Any]:
        """Make the recordings, the dataset and its split; returns the numbers of traversals and frames."""
        road, recordings, dataset = self.road, self.folder / "recordings", self.folder / "dataset"
        rig = StreetRig(int(road.recordings["height_px"]), int(road.recordings["width_px"]))
        folders = []
        for route in road.routes:
            for seed in road.recordings["seeds"]:
                drive = self.drive(f"{route}-s{seed}")
                folders.append(recordings / drive.drive_id)
                write_recording(folders[-1], drive, rig, float(road.recordings["spacing_m"]), road.stretch_m)
        if not (dataset / "index" / "snapshots").is_dir():
            write_region(recordings / "rois.geojson", drive, road.name)
            _run("ingest", *map(str, folders), "--rois", str(recordings / "rois.geojson"), "--out", str(dataset),
                 "--workers", "1", "--licence", "CC0-1.0")  # fmt: skip
        if not (dataset / "splits" / f"{SPLIT}.json").is_file():
            _run("split", str(dataset), SPLIT, "--method", "by-scene", "--train", "1", "--val", "0", "--test", "0")
        self._require_true_poses()
        return {"traversals": len(self.dataset.traversals()), "frames": len(self.dataset.frames())}

    def reconstruct(self) -> dict[str, Any]:
        """Reconstruct the road, or continue; returns costs, and the PSNR of the last training images."""
        options = self.road.reconstruction
        _run("reconstruct", str(self.folder / "dataset"), "--split", SPLIT, "--out", str(self.model),
             "--method", options["method"], "--minutes", str(options["minutes"]), "--width", str(options["width"]),
             "--initialise", options["initialise"], "--seed", str(options["seed"]), "--threads", "1",
             "--device", "cpu")  # fmt: skip
        costs = read_reconstruction(self.model).done
        folders = [RunFolder(path, TrainingOutcome) for path in sorted(self.model.glob("block_*"))]
        blocks = [outcome for folder in folders if (outcome := folder.outcome)]
        return {
            "training_core_s": None if costs is None else costs.core_s,
            "blocks": len(blocks),
            "psnr_db": float(np.mean([block.psnr_db for block in blocks])),
            "model_bytes": sum(block.model_bytes for block in blocks),
        }

    def render(self, clip: Clip) -> UInt8:
        """Render a clip's views (F, V, H, W, 3) in the appearance of its route's first recording.

        Raises:
            DatasetError: the clip's poses are not those of its drive.
        """
        route, _, _ = clip.drive_id.rpartition("-s")
        return render_backgrounds(
            clip,
            self.world_SE3_ego(clip),
            self._renderer,
            traversal_id=self._traversals[f"{route}-s{self.road.recordings['seeds'][0]}"],
            scene_id=self.road.name,
            factor=self.road.factor,
        )

    def world_SE3_ego(self, clip: Clip) -> Poses:  # noqa: N802
        """Return the poses of the vehicle at the frames of a clip, in the world of the road's scene."""
        _, _, first = clip.clip_id.rpartition("-")
        return self.drive(clip.drive_id).truth.poses((int(first) + np.arange(len(clip))) / clip.rate_hz)

    @cached_property
    def _renderer(self) -> Callable[[RenderView], UInt8]:
        method = installed_method(read_reconstruction(self.model).method)
        return method.open(self.model, AppearancePolicy())

    @cached_property
    def _traversals(self) -> dict[str, str]:
        rows = self.dataset.table("traversals", ["traversal_id", "drive_id"]).to_pylist()
        return {row["drive_id"]: row["traversal_id"] for row in rows}

    def drive(self, drive_id: str) -> SynthDrive:
        """Return a drive along the road; the last one is kept."""
        route, _, seed = drive_id.rpartition("-s")
        return _make_drive(self.road.preset, route, int(seed), self.road.bustle, drive_id)

    def _require_true_poses(self) -> None:
        """Require that the world of the dataset is that of the drives: clips are placed in it by their true poses."""
        drive = self.drive(f"{self.road.routes[-1]}-s{self.road.recordings['seeds'][-1]}")
        traversal_id = self._traversals[drive.drive_id]
        frames = self.dataset.where(traversal=traversal_id).frames()
        stamps = np.array([frames[0].timestamp_ns, frames[-1].timestamp_ns])
        recorded = interpolate(*frames[0].track, stamps)
        apart = np.abs(recorded.matrix() - drive.world_SE3_ego(stamps).matrix()).max()
        if not apart <= _AGREE_M:
            raise DatasetError(
                f"poses that differ from the true ones by {apart:.2g}", file=self.dataset.root, place=traversal_id,
                expected=f"at most {_AGREE_M:g}: the frame of the drive's scene",
            )  # fmt: skip


@lru_cache(1)
def _make_drive(preset: str, route: str, seed: int, bustle: float, drive_id: str) -> SynthDrive:
    return busy_drive(preset, route, seed, bustle, drive_id)


def _run(*words: str) -> None:
    """Run a verb of `mirror` in this process.

    Raises:
        DatasetError: it did not end with 0.
    """
    from mirror.cli.main import main

    if code := main(list(words)):
        raise DatasetError(f"`mirror {words[0]}` ended with {code}", expected="0")
