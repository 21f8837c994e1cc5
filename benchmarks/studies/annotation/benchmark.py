"""Accuracy of the tiny PETR over processor time of training; `experiment.toml` is declared and hashed."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.studies.annotation.declaration import Declaration, load_declaration
from benchmarks.studies.annotation.inputs import fit_and_try
from benchmarks.studies.annotation.references import ground_boxes, prior_boxes
from benchmarks.studies.annotation.scoring import CLASS, Found, TestFrame, operating_points, read_test_frames, score
from benchmarks.studies.annotation.streets import assign_drives, open_streets, recordings_of
from hybridworldsim.petr.tiny.network import TinyPetr
from hybridworldsim.petr.tiny.samples import Sample
from mirror.progress import ProgressReporter
from mirror.schema.json_lines import append_line, decode_object, read_lines

_SCORES: Final = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6)
OUTCOMES: Final = Path(__file__).with_name("outcomes.jsonl")


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks annotation", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("declared", help="print the hash of the declaration")
    verbs.add_parser("show", help="print the table of the outcomes")
    for name, text in (
        ("train", "train with each budget and seed; continues"),
        ("score", "score the finished runs that have no outcome yet"),
        ("curve", "score copies of checkpoints of a run, in the folder --out"),
        ("references", "score what needs no training"),
        ("points", "precision and recall of the model --out, by the least score of boxes"),
    ):
        verb = verbs.add_parser(name, help=text)
        verb.add_argument("--streets", type=Path, required=True, help="folder of recordings-N and dataset-N")
        if name != "references":
            verb.add_argument("--out", type=Path, required=True, help="folder of the runs, or of checkpoints; a model")
        if name == "train":
            verb.add_argument("--minutes", type=float, help="this budget alone")
            verb.add_argument("--seed", type=int, help="this seed alone")
    images = verbs.add_parser("inputs", help="learn and try the test of input statistics of the network that ships")
    images.add_argument("--out", type=Path, required=True, help="folder of rendered images")
    arguments = parser.parse_args(argv)
    if arguments.verb == "inputs":
        fit_and_try(arguments.out)
        return 0
    declaration = load_declaration()
    print(f"declaration {declaration.hash}", flush=True)
    match arguments.verb:
        case "train":
            _train(declaration, arguments)
        case "score":
            _score(declaration, arguments)
        case "curve":
            _score_checkpoints(declaration, arguments)
        case "references":
            _references(declaration, arguments)
        case "points":
            _points(declaration, arguments)
        case "show":
            _show(declaration)
    return 0


def _test_frames(declaration: Declaration, folder: Path) -> tuple[list[TestFrame], list[TestFrame]]:
    """Frames of held-out scenes, and of unseen drives of known scenes."""
    from hybridworldsim.petr.tiny.settings import NetworkSettings

    held_out, known = list[TestFrame](), list[TestFrame]()
    for seed in declaration.streets.seeds:
        dataset, recordings = open_streets(folder, seed), recordings_of(folder, seed)
        drives = assign_drives(declaration.streets, seed)
        for names, frames in ((drives.held_out, held_out), (drives.known, known)):
            for name in names:
                view = dataset.where(drive=name)
                frames += read_test_frames(view, recordings, declaration.bar, NetworkSettings())
    return held_out, known


def _training_samples(declaration: Declaration, folder: Path, bar: ProgressReporter) -> list[Sample]:
    from hybridworldsim.petr.tiny.run import read_training_samples
    from hybridworldsim.petr.tiny.settings import NetworkSettings, training_settings

    training = training_settings(declaration.settings)
    views = [
        open_streets(folder, seed).where(drive=list(assign_drives(declaration.streets, seed).training))
        for seed in declaration.streets.seeds
    ]
    return read_training_samples(views, NetworkSettings(), training, bar)


def _train(declaration: Declaration, arguments: argparse.Namespace) -> None:
    from hybridworldsim.petr.tiny.run import train_on_samples
    from hybridworldsim.petr.tiny.settings import training_settings
    from mirror.annotation.protocol import TrainingTask
    from mirror.progress import progress_bar

    with progress_bar(quiet=False) as bar:
        samples = _training_samples(declaration, arguments.streets, bar)
        for minutes, seed in product(declaration.core_minutes, declaration.seeds):
            if arguments.minutes in (None, minutes) and arguments.seed in (None, seed):
                task = TrainingTask(None, minutes, seed, declaration.threads, declaration.settings)
                out = _folder(arguments.out, minutes, seed)
                report = train_on_samples(samples, training_settings(declaration.settings), task, out, bar)
                bar.message(json.dumps(asdict(report)))


def _folder(out: Path, minutes: float, seed: int) -> Path:
    return out / f"{minutes:g}min-seed{seed}"


def _score(declaration: Declaration, arguments: argparse.Namespace) -> None:
    from hybridworldsim.petr.tiny.model_file import read_model
    from hybridworldsim.petr.tiny.run import AnnotatorOutcome, AnnotatorRun
    from mirror.schema.files import read_json

    scored = {(row.get("minutes"), row.get("seed")) for row in _rows(declaration)}
    held_out, known = _test_frames(declaration, arguments.streets)
    for minutes, seed in product(declaration.core_minutes, declaration.seeds):
        folder = _folder(arguments.out, minutes, seed)
        if (minutes, seed) in scored or not (folder / "outcome.json").exists():
            continue
        run, outcome = (
            read_json(folder / "run.json", AnnotatorRun),
            read_json(folder / "outcome.json", AnnotatorOutcome),
        )
        network, _ = read_model(folder / "model.safetensors")
        scores = _both(held_out, known, _finder(network), declaration)
        trained = {"trained_frames": run.frames, "trained_boxes": run.boxes}
        row = {"minutes": minutes, "seed": seed, **outcome.model_dump(), **trained, **scores}
        _append(declaration, row)
        print(json.dumps(row), flush=True)


def _both(
    held_out: list[TestFrame], known: list[TestFrame], find: Callable[[TestFrame], Found], declaration: Declaration
) -> dict[str, Any]:
    """The scores on scenes that are held out and, under `known`, on unseen drives of known scenes."""
    return {
        **asdict(score(held_out, find, declaration.bar)),
        "known": asdict(score(known, find, declaration.bar)),
    }


def _score_checkpoints(declaration: Declaration, arguments: argparse.Namespace) -> None:
    from hybridworldsim.petr.tiny.network import TinyPetr
    from hybridworldsim.petr.tiny.settings import NetworkSettings
    from hybridworldsim.training.run.checkpoint import read_checkpoint

    held_out, known = _test_frames(declaration, arguments.streets)
    for path in sorted(arguments.out.glob("*.safetensors")):
        state, position = read_checkpoint(path)
        network = TinyPetr(NetworkSettings()).eval()
        averaged = {
            name.removeprefix("averaged."): value for name, value in state.items() if name.startswith("averaged.")
        }
        network.load_state_dict(averaged)
        scores = _both(held_out, known, _finder(network), declaration)
        row = {"checkpoint": path.stem, "steps": position.steps, "core_s": position.spent_s, **scores}
        _append(declaration, row)
        print(json.dumps(row), flush=True)


def _finder(network: TinyPetr) -> Callable[[TestFrame], Found]:
    from hybridworldsim.petr.tiny.detect import find_boxes
    from hybridworldsim.petr.tiny.settings import CLASSES

    label = CLASSES.index(CLASS)

    def find(frame: TestFrame) -> Found:
        boxes = find_boxes(network, frame.cameras)
        cars = boxes.label == label
        values = (boxes.centre_m, boxes.size_m, boxes.yaw_rad, boxes.score)
        return Found(*(value[cars].double().numpy() for value in values))

    return find


def _references(declaration: Declaration, arguments: argparse.Namespace) -> None:
    from mirror.progress import NullProgress

    samples = _training_samples(declaration, arguments.streets, NullProgress())
    prior = prior_boxes(samples, declaration.bar.range_m)
    held_out, known = _test_frames(declaration, arguments.streets)
    for name, find in (("prior", lambda _: prior), ("ground", ground_boxes(prior))):
        row = {"reference": name, **_both(held_out, known, find, declaration)}
        _append(declaration, row)
        print(json.dumps(row))


def _points(declaration: Declaration, arguments: argparse.Namespace) -> None:
    from hybridworldsim.petr.tiny.model_file import read_model

    network, _ = read_model(arguments.out)
    held_out, known = _test_frames(declaration, arguments.streets)
    print("| score at least | precision, known scenes | recall | precision, held-out scenes | recall |")
    print("|---|---|---|---|---|")
    both = (operating_points(frames, _finder(network), declaration.bar, _SCORES) for frames in (known, held_out))
    for one, other in zip(*both):
        values = (one.score, one.precision, one.recall, other.precision, other.recall)
        print(f"| {' | '.join(f'{value:.2f}' for value in values)} |")


def _rows(declaration: Declaration) -> list[dict[str, Any]]:
    return [row for row in read_lines(OUTCOMES, decode_object) if row["declaration"] == declaration.hash]


def _append(declaration: Declaration, row: dict[str, Any]) -> None:
    append_line(OUTCOMES, json.dumps({"declaration": declaration.hash, **row}, sort_keys=True))


def _show(declaration: Declaration) -> None:
    rows = _rows(declaration)
    print(
        "| trained | core-minutes | steps | frames | mAP | AP@0.5 | AP@1 | AP@2 | AP@4 | position | heading "
        "| mAP, known scenes | AP@2 | AP@4 |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        if "reference" in row:
            _print_row((row["reference"], "", "", ""), [row])
    for row in sorted((row for row in rows if "checkpoint" in row), key=lambda row: row["core_s"]):
        _print_row(("on the way", f"{row['core_s'] / 60:.1f}", str(row["steps"]), ""), [row])
    for minutes in declaration.core_minutes:
        chosen = [row for row in rows if row.get("minutes") == minutes]
        for row in chosen:
            spent = f"{row['core_s'] / 60:.1f}"
            _print_row((f"seed {row['seed']}", spent, str(row["steps"]), str(row["trained_frames"])), [row])
        if chosen:
            _print_row((f"mean of {len(chosen)}", f"{minutes:g}", "", ""), chosen)


def _print_row(names: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    def mean(name: str) -> float:
        return float(np.mean([row[name] for row in rows]))

    aps = [float(np.mean([row["ap"][key] for row in rows])) for key in ("0.5", "1", "2", "4")]
    values = [f"{value:.3f}" for value in (mean("mean_ap"), *aps)]
    errors = [f"{mean('translation_m'):.2f} m", f"{mean('heading_rad'):.2f} rad"]
    known = [np.mean([row["known"]["mean_ap"] for row in rows])]
    known += [np.mean([row["known"]["ap"][key] for row in rows]) for key in ("2", "4")]
    print(f"| {' | '.join([*names, *values, *errors, *(f'{value:.3f}' for value in known)])} |")
