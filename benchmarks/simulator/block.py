"""The trained block that the benchmark drives in, as `mirror demo` makes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from benchmarks.report import OUT
from hybridworldsim.simulator.street.ground import StreetGround
from hybridworldsim.simulator.street.opening import open_street
from hybridworldsim.simulator.street.street import Street
from mirror.synth import street_map

PRESET, SEED = "block", 0


def trained_block(folder: Path | None) -> tuple[Path, Path]:
    """Return the dataset and model of the block in a folder; they are made there if they are missing."""
    from mirror.cli.demo import run

    out = folder or OUT / "simulator" / "block"
    dataset, model, recordings = out / "dataset", out / "model", out / "recordings"
    if not (dataset / "dataset.json").is_file():
        run(["mirror", "synth", "--out", str(recordings), "--preset", PRESET, "--seed", str(SEED)])
        drives = sorted(str(path.parent) for path in recordings.glob("*/recording.json"))
        rois = str(recordings / "rois.geojson")
        run(["mirror", "ingest", *drives, "--rois", rois, "--out", str(dataset), "--licence", "CC0-1.0"])
        run(["mirror", "split", str(dataset), "novel", "--seed", str(SEED)])
    budget = ["--minutes", "1.5", "--width", "160", "--initialise", "plane-sweep"]
    run(["mirror", "reconstruct", str(dataset), "--split", "novel", *budget, "--device", "cpu", "--out", str(model)])
    return dataset, model


def open_block(dataset: Path, preset: str = PRESET) -> Street:
    """Return the street of the block, with its exact world, ground and map."""
    from mirror.synth.fleet.drives import make_drives

    street = open_street(str(dataset))
    drive = make_drives(preset, SEED, traversals=1)[1][0]
    ground, road_map = StreetGround(drive.world.height_m), street_map(drive.world.plan)
    return replace(street, drive=drive, ground=ground, road_map=road_map)
