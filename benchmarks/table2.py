"""Table 2 of the paper on a public dataset: from its folder to the rows of ours and of the paper's baseline.

``python -m benchmarks table2 NAME DIR [--out FOLDER] [--methods NAME,...] [--steps N] [--dry-run]``. NAME is
`nuscenes-mini`, `nuplan`, `mtgs-blocks`, `kitti-360` or `euvs`; DIR is the dataset as its owners lay it out. The run
calls the verbs that a user would call, prints each one, and skips what is finished, so that it continues.
``--dry-run`` prints the commands and runs none; what depends on the scenes found is printed as SCENE.

Differences to the paper: initialisation from images instead of lidar; the training traversals are drawn by our split,
because the other projects number the passes of their own extracts. KITTI-360 and EUVS are not in the paper's table;
road users of EUVS are not masked, because its masks belong to no box.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from benchmarks.report import OUT
from mirror.errors import ExitCode, UsageError
from mirror.schema.files import write_json

_MULTI: Final = "static-reconstruction"
_SINGLE: Final = "static-reconstruction-omnire"
# Northern UTM zones of nuPlan's cities.
_SINGAPORE, _PITTSBURGH, _BOSTON = 48, 17, 19
_BLOCKS: Final = (
    (_SINGAPORE, (365530, 143960, 365630, 144060)),
    (_SINGAPORE, (365000, 144000, 365100, 144080)),
    (_PITTSBURGH, (587400, 4475700, 587480, 4475800)),
    (_BOSTON, (331220, 4690660, 331190, 4690710)),
    (_PITTSBURGH, (587640, 4475600, 587710, 4475660)),
    (_PITTSBURGH, (587860, 4475510, 587910, 4475570)),
)
"""The road blocks of MTGS (arXiv 2503.12552): the UTM zone, and two opposite corners in metres."""
# Its traversals of a block are 57 to 105 m long.
_BLOCK_RADIUS_M: Final = 50.0
_PAPER: Final[Mapping[str, Mapping[str, Sequence[float]]]] = {
    "nuscenes-mini": {"omnire_style": (27.70, 0.826, 0.179), "hybridworldsim": (30.39, 0.886, 0.147)},
    "mtgs-blocks": {
        "mtgs_style": (28.04, 0.848, 0.192, 21.65, 0.628, 0.265),
        "hybridworldsim": (29.17, 0.873, 0.129, 22.11, 0.606, 0.219),
    },
}
"""Table 2: PSNR, SSIM, LPIPS of training views; PSNR*, SSIM, LPIPS of novel ones."""


@dataclass(frozen=True)
class PublicDataset:
    """A dataset of others.

    Attributes:
        reader: reader of its folder.
        scenes: largest number of scenes.
        traversals: least number of traversals of a scene.
        split: options of `mirror split`.
        methods: the paper's baseline, and ours.
        protocol: protocol that scores the rows.
        hold_out: whether scored frames of training traversals are left out of training.
        masks: whether the dataset has boxes, which mask road users.
        ingest: further options of `mirror rois propose` and `mirror ingest`.
    """

    reader: str
    scenes: int
    traversals: int
    split: tuple[str, ...]
    methods: tuple[str, ...] = ("mtgs_style", "hybridworldsim")
    protocol: str = _MULTI
    hold_out: bool = False
    masks: bool = True
    ingest: tuple[str, ...] = ()


_ONE_SPLIT: Final = ("--method", "by-scene", "--train", "1", "--val", "0", "--test", "0")
_FOUR: Final = ("--train", "3", "--held-out-traversals", "1")
# Images of a structure-from-motion model have no stamps: speeds say nothing, and neither does a duration.
_POSED: Final = (
    "--min-duration-s", "0.1", "--min-path-m", "1", "--max-speed-mps", "1e6", "--max-acceleration-mps2", "1e9",
)  # fmt: skip
DATASETS: Final = {
    "nuscenes-mini": PublicDataset(
        "nuscenes", 10, 1, _ONE_SPLIT, ("omnire_style", "hybridworldsim"), _SINGLE, hold_out=True
    ),
    "nuplan": PublicDataset("nuplan", 6, 4, _FOUR),
    "mtgs-blocks": PublicDataset("nuplan", len(_BLOCKS), 4, _FOUR, ingest=("--min-duration-s", "3")),
    "kitti-360": PublicDataset("kitti360", 6, 2, ("--train", "1", "--held-out-traversals", "1")),
    "euvs": PublicDataset("colmap", 1, 1, (), masks=False, ingest=_POSED),
}


@dataclass(frozen=True)
class Table2Arguments:
    """Make the rows of the paper's Table 2 on a public dataset."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")]
    """nuscenes-mini, nuplan, mtgs-blocks, kitti-360 or euvs."""
    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder of the dataset."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: build/table2/NAME)")] = (
        None
    )
    """Working folder: dataset, models, submissions and results."""
    methods: str = ""
    """Methods, separated by commas. Empty: the paper's baseline, and ours."""
    scenes: int = 0
    """Largest number of scenes; 0: as many as the table has."""
    steps: int = 30_000
    """Training images per block."""
    width: int = 960
    """Width of training images in pixels."""
    device: str = "auto"
    """Device that trains and renders: auto, cpu or cuda."""
    radius_m: float = 100.0
    """Radius of proposed scenes in metres. The road blocks of MTGS have their own."""
    dry_run: bool = False
    """Print the commands and run none."""


@dataclass(frozen=True)
class _Run:
    """The commands of a run, in their order.

    Attributes:
        arguments: what was asked.
        spec: the dataset.
        out: the working folder.
    """

    arguments: Table2Arguments
    spec: PublicDataset
    out: Path

    def call(self, result: Path, *words: object) -> None:
        """Print a command, and run it unless its result exists."""
        from mirror.cli.main import main as verb

        line = " ".join(("mirror", *map(str, words)))
        done = result.exists()
        print(f"# finished: {line}" if done else line, flush=True)
        if done or self.arguments.dry_run:
            return
        code = verb([str(word) for word in words])
        if code not in (ExitCode.DONE, ExitCode.PARTLY_DONE):
            raise UsageError(
                f"`{line}` ended with code {code}", expected="its result", remedy="mend what it names, run this again"
            )


def block_circles() -> Iterator[tuple[float, float, float, str]]:
    """Yield longitude and latitude in degrees, radius in metres and id of the circle around each block of MTGS."""
    from mirror.geometry.geodesy import utm_to_geodetic

    for zone, (x0, y0, x1, y1) in _BLOCKS:
        lon, lat = utm_to_geodetic((x0 + x1) / 2, (y0 + y1) / 2, zone, True)
        yield float(lon), float(lat), _BLOCK_RADIUS_M, f"block_{x0}_{y0}"


def arrange_euvs(source: Path, out: Path) -> None:
    """Write a scene of EUVS as a COLMAP folder with the drives `train...` and `test...`, as its `test_set.txt` says.

    Images become hard links, or copies where links are not possible.

    Args:
        source: the scene: `images`, `sparse/0` and `test_set.txt`.
        out: the new folder.

    Raises:
        UsageError: the scene lacks one of them, or no image is listed.
    """
    import pycolmap

    listed = source / "test_set.txt"
    for needed in (listed, source / "images", source / "sparse" / "0"):
        if not needed.exists():
            raise UsageError(f"{needed} is missing", expected="a scene of EUVS: images, sparse/0 and test_set.txt")
    test = set(listed.read_text().split())
    model = pycolmap.Reconstruction(str(source / "sparse" / "0"))
    partial = out.with_name(f"{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    for image in model.images.values():
        role = "test" if image.name in test else "train"
        *folders, file = image.name.split("/")
        camera = folders.pop() if folders else f"camera_{image.camera_id}"
        name = "/".join(("-".join((role, *folders)), camera, file))
        target = partial / "images" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            target.hardlink_to(source / "images" / image.name)
        except OSError:
            shutil.copyfile(source / "images" / image.name, target)
        image.name = name
    if not all(any((partial / "images").glob(f"{role}*")) for role in ("train", "test")):
        raise UsageError("all images are of one part", place=str(listed), expected="names of some images, one a line")
    (partial / "sparse" / "0").mkdir(parents=True)
    model.write(str(partial / "sparse" / "0"))
    partial.rename(out)


def make_dataset(run: _Run) -> Path:
    """Call the verbs from the folder to a divided dataset, and return the dataset."""
    arguments, spec, dataset = run.arguments, run.spec, run.out / "dataset"
    recording = arguments.data
    if arguments.name == "euvs":
        recording = run.out / "recording"
        if not recording.exists() and not arguments.dry_run:
            arrange_euvs(arguments.data, recording)
    read = ("--reader", spec.reader, *spec.ingest)
    if arguments.name == "mtgs-blocks":
        circles = list(block_circles())[: arguments.scenes or spec.scenes]
        regions: list[object] = []
        for lon, lat, radius_m, key in circles:
            regions += ["--roi", f"{lon:.6f},{lat:.6f},{radius_m:.1f},{key}"]
    else:
        rois = run.out / "rois.geojson"
        count = arguments.scenes or spec.scenes
        run.call(
            rois, "rois", "propose", recording, *read, "--count", count, "--min-traversals", spec.traversals,
            "--radius-m", f"{arguments.radius_m:g}", "--out", rois,
        )  # fmt: skip
        regions = ["--rois", rois]
    run.call(run.out / "ingested", "ingest", recording, *regions, *read, "--out", dataset)
    if not arguments.dry_run:
        (run.out / "ingested").touch()
    words = spec.split
    if arguments.name == "euvs":
        words = ("--method", "by-list", *_held_out(dataset, dry=arguments.dry_run))
    run.call(dataset / "splits" / "table2.json", "split", dataset, "table2", *words)
    return dataset


def _held_out(dataset: Path, *, dry: bool) -> Iterator[str]:
    """Yield the options that hold out the traversals of the drives `test...`."""
    import mirror

    ids = ["TRAVERSAL"] if dry else list(mirror.open(dataset).traversals())
    for key in ids:
        if dry or ".test" in key:
            yield from ("--held-out-id", key)


def make_row(run: _Run, dataset: Path, method: str) -> dict[str, Any] | None:
    """Train, render and score a method; None on a dry run."""
    arguments, spec = run.arguments, run.spec
    own = run.out / method
    split = dataset / "splits" / "table2.json"
    scenes = ["SCENE"]
    if split.is_file():
        roles = json.loads(split.read_text())["assignments"]
        scenes = sorted({key.partition(".")[0] for key, role in roles.items() if role == "train"})
    asked = ("--split", "table2", "--protocol", spec.protocol)
    masks = () if spec.masks else ("--no-masks",)
    held = (*masks, "--hold-out") if spec.hold_out else masks
    models = [own / scene for scene in scenes]
    for scene, model in zip(scenes, models, strict=True):
        run.call(
            model / "reconstruction.json", "reconstruct", dataset, *asked, *held, "--scene", scene, "--method", method,
            "--initialise", "plane-sweep", "--steps", arguments.steps, "--width", arguments.width,
            "--device", arguments.device, "--out", model,
        )  # fmt: skip
    run.call(
        own / "submission" / "manifest.json", "render", dataset, *models, *asked, *masks, "--device", arguments.device,
        "--out", own / "submission",
    )  # fmt: skip
    result = own / "results" / "result.json"
    protocol = spec.protocol if spec.masks else f"{spec.protocol}-unmasked"
    run.call(result, "evaluate", dataset, own / "submission", "--protocol", protocol, "--out", own / "results")
    return None if arguments.dry_run else read_row(result, method)


def read_row(result: Path, method: str) -> dict[str, Any]:
    """Return the figures of a result by group and metric; None for one without a value."""
    figures = json.loads(result.read_text())["figures"]
    of_groups = [one for one in figures if one["level"] == "group"]
    return {"method": method, "figures": {f"{one['group']}/{one['metric']}": one["value"] for one in of_groups}}


def report_rows(name: str, rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the table of a dataset: our rows, and the paper's."""
    first = "held-out-frames" if DATASETS[name].protocol == _SINGLE else "training"
    columns = [f"{first}/{metric}" for metric in ("psnr", "ssim", "lpips_alex")]
    columns += [f"novel/{metric}" for metric in ("psnr_cc", "ssim", "lpips_alex")] if first == "training" else []
    titles = ["PSNR", "SSIM", "LPIPS", "novel PSNR*", "novel SSIM", "novel LPIPS"][: len(columns)]
    yield f"| {name} | {' | '.join(titles)} |"
    yield "|---" * (len(titles) + 1) + "|"
    for row in rows:
        measured = [row["figures"].get(column) for column in columns]
        yield f"| {row['method']} | {' | '.join(map(_text, measured))} |"
    published = _PAPER.get(name, {})
    for method, values in published.items():
        yield f"| the paper's {method} | {' | '.join(map(_text, values))} |"


def _text(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.2f}" if value > 2 else f"{value:.3f}"


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = tyro.cli(Table2Arguments, args=list(argv), prog="python -m benchmarks table2")
    if arguments.name not in DATASETS:
        raise UsageError(f"no dataset {arguments.name!r}", place="NAME", expected=f"one of {', '.join(DATASETS)}")
    if not arguments.data.is_dir():
        raise UsageError(f"no folder {arguments.data}", place="DIR", expected="the dataset as its owners lay it out")
    spec = DATASETS[arguments.name]
    out = arguments.out or OUT / "table2" / arguments.name
    if not arguments.dry_run:
        out.mkdir(parents=True, exist_ok=True)
    run = _Run(arguments, spec, out)
    dataset = make_dataset(run)
    methods = arguments.methods.split(",") if arguments.methods else spec.methods
    rows = [make_row(run, dataset, method) for method in methods]
    if not arguments.dry_run:
        found = [row for row in rows if row is not None]
        write_json(out / "rows.json", {"dataset": arguments.name, "rows": found})
        print(*report_rows(arguments.name, found), sep="\n")
    return ExitCode.DONE
