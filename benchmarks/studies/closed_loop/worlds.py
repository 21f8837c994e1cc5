"""The worlds that the policies drive in: the exact one, and those that methods reconstructed from recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import mirror
from benchmarks.studies.closed_loop.exact_camera import ExactCamera
from benchmarks.studies.closed_loop.streets import Place
from hybridworldsim.methods.static import StaticMethod
from hybridworldsim.simulator.renderers.protocol import Renderer
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.simulation import Simulation
from hybridworldsim.simulator.street.street import Street
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.methods.plugin import ReconstructionTask
from mirror.methods.registry import installed_method
from mirror.progress import ProgressReporter
from mirror.protocols.document import load_protocol


@dataclass(frozen=True, eq=False)
class ExactWorld:
    """The exact street as a world of rollouts.

    Attributes:
        noise: seed of the images' noise.
        model: hash of the model; there is none.
    """

    noise: int
    model: str = ""

    def renderer(self, simulation: Simulation, place: Place) -> Renderer:
        """Return the renderer of a rollout."""
        seed = (self.noise, simulation.seed)
        return ExactCamera(place, simulation.now.agents, simulation.street.clock_s, seed)


@dataclass(frozen=True, eq=False)
class ReconstructedWorld:
    """A reconstructed street as a world of rollouts.

    Attributes:
        folder: folder of the model.
        dataset: dataset that it was trained on.
        model: first digits of the model's hash.
    """

    folder: Path
    dataset: Path
    model: str

    def renderer(self, simulation: Simulation, place: Place) -> Renderer:
        """Return the renderer of a rollout, in the light of the exact world's drive."""
        traversal = self._traversals[place.drive.drive_id]
        recording = next(iter(place.street.recordings.values()))
        street: Street = replace(place.street, recordings={traversal: replace(recording, traversal_id=traversal)})
        return ReconstructedRenderer(
            self._open(street), street, simulation.scenario, simulation.now, place.cameras, traversal
        )

    def _open(self, street: Street) -> OpenModel:
        if "_model" not in vars(self):
            vars(self)["_model"] = OpenModel.read(self.folder, street)
        model: OpenModel = vars(self)["_model"]
        return model

    @cached_property
    def _traversals(self) -> Mapping[str, str]:
        rows = mirror.open(self.dataset).table("traversals", ["traversal_id", "drive_id"]).to_pylist()
        return {row["drive_id"]: row["traversal_id"] for row in rows}


World = ExactWorld | ReconstructedWorld


def make_recordings(folder: Path, streets: Mapping[str, Any], seed: int) -> None:
    """Make the recordings, the dataset and the split of a street, as far as they are missing."""
    from mirror.cli.main import main

    recordings, dataset = folder / "recordings", folder / "dataset"
    if not (dataset / "index" / "snapshots").is_dir():
        _run(main, ["synth", "--out", str(recordings), "--preset", streets["preset"], "--seed", str(seed),
                    "--scenes", "1", "--workers", "1"])  # fmt: skip
        drives = [str(path.parent) for path in sorted(recordings.glob("*/recording.json"))]
        _run(main, ["ingest", *drives, "--rois", str(recordings / "rois.geojson"), "--out", str(dataset),
                    "--licence", "CC0-1.0"])  # fmt: skip
    if not (dataset / "splits" / f"{streets['split']}.json").is_file():
        _run(main, ["split", str(dataset), streets["split"], "--method", "by-condition", "--train-on", "light=day",
                    "--train-on", "light=night", "--test-on", "light=dusk"])  # fmt: skip


def _run(main: object, words: list[str]) -> None:
    code = main(words)  # type: ignore[operator]
    if code:
        raise DatasetError(f"`mirror {words[0]}` ended with {code}", expected="0")


def make_task(streets: Mapping[str, Any], declared: Mapping[str, Any], core_minutes: float) -> ReconstructionTask:
    """Return the reconstruction that a method gets."""
    protocol = load_protocol("static-reconstruction")
    pixels = protocol.pixels.model_copy(update={"max_width_px": declared["width_px"]})
    return ReconstructionTask(
        scene=streets["site"],
        split=streets["split"],
        protocol=protocol.model_copy(update={"pixels": pixels}),
        core_minutes=core_minutes,
        initialise=declared["initialise"],
        threads=1,
    )


def reconstruct(
    dataset: Dataset, method: str, task: ReconstructionTask, block_m: float, out: Path, progress: ProgressReporter
) -> dict[str, Any]:
    """Train a method on a street, or continue; returns its costs.

    Raises:
        UsageError: the method has no blocks.
    """
    installed = installed_method(method)
    if not isinstance(installed, StaticMethod):
        raise UsageError(f"method {method} has no blocks", expected="a method of hybridworldsim.methods.static")
    done = replace(installed, block_m=block_m).reconstruct(dataset, task, out, progress)
    return {
        "core_s": done.core_s, "psnr_db": done.psnr_db, "blocks": len(done.blocks), "gaussians": done.gaussians,
        "model_bytes": done.model_bytes, "steps": done.steps,
    }  # fmt: skip
