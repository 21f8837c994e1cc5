"""`mirror reconstruct` and `mirror render`: from a dataset to a submission, and along a line that nobody drove."""

from __future__ import annotations

import json
import math
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import mirror
from hybridworldsim.methods.device_shares import divide_blocks
from hybridworldsim.methods.layers import layer_source, layers_for
from hybridworldsim.model.blocks import Block, divide, select_views
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.training.data_loader import TrainingImageCache
from hybridworldsim.training.run.folder import lock_run
from hybridworldsim.training.views import training_views
from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.model_document import (
    Reconstruction,
    list_trained_traversals,
    read_reconstruction,
    require_matching_split,
)
from mirror.methods.plugin import ReconstructionTask
from mirror.methods.registry import installed_method
from mirror.progress import NullProgress, progress_bar
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.view import RenderView
from mirror.schema.tables import BOXES, DEPTH, POINTS
from tests.baselines.conftest import dataset as street  # noqa: F401 - a fixture
from tests.builders.lanes import add_initial_points
from tests.builders.street import make_street
from tests.interruption import interrupt_before

STEPS = 40


@pytest.fixture(autouse=True)
def _threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def initialised(made_street: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The street with points of its training traversals, a wall on either side, and a depth map of each."""
    return add_initial_points(
        mirror.open(shutil.copytree(made_street, tmp_path_factory.mktemp("initialised") / "dataset"))
    )


@pytest.fixture
def dataset(initialised: Dataset, tmp_path: Path) -> Dataset:
    """A copy, which tests may change."""
    return mirror.open(shutil.copytree(initialised.root, tmp_path / "dataset"))


@pytest.fixture(scope="module")
def model(initialised: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of three steps, which tests do not change."""
    folder = tmp_path_factory.mktemp("trained") / "model"
    assert main([str(word) for word in reconstruct(initialised, folder, "--steps", 3)]) == ExitCode.DONE
    return folder


def point(number: int) -> dict[str, Any]:
    return {
        "point": number, "x_m": float(number % 7), "y_m": 12.0, "z_m": float(number // 7), "r": 9, "g": 9, "b": 9,
        "kind": "background", "views": 2, "sigma_m": None,
    }  # fmt: skip


def said(capsys: pytest.CaptureFixture[str], *words: object, code: int = ExitCode.DONE) -> dict[str, Any]:
    assert main([str(word) for word in (*words, "--json")]) == code
    return json.loads(capsys.readouterr().out)


def reconstruct(dataset: Dataset, out: Path, *more: object) -> tuple[object, ...]:
    words = ("--split", "novel", "--out", out, "--steps", STEPS, "--width", 48, "--threads", 1)
    return ("reconstruct", dataset.root, *words, *more)


def driven_as_documented(dataset: Dataset, model: Path) -> dict[str, Any]:
    """Return what the example of docs/reconstruction/render.md leaves behind."""
    text = (Path(__file__).parents[2] / "docs" / "reconstruction" / "render.md").read_text()
    code = text.partition("## From Python")[2].partition("```python\n")[2].partition("```")[0]
    for word, meant in (("DATASET", dataset.root), ("MODEL", model), ("night", "day")):
        assert code.count(f'"{word}"') == 1
        code = code.replace(f'"{word}"', repr(str(meant)))
    names: dict[str, Any] = {}
    exec(code, names)
    return names


def test_from_a_dataset_to_a_submission_and_along_a_new_line(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model"
    done = said(capsys, *reconstruct(dataset, model))
    assert done["steps"] == STEPS * len(done["blocks"]) and done["psnr_db"] > 9.0
    assert done["points"] == "made@1" and done["pictures"] > 0 and done["driven_m"] > 10.0
    document = read_reconstruction(model)
    assert document.method == "hybridworldsim" and document.done is not None
    assert document.done.model_bytes == done["model_bytes"]
    block = model / done["blocks"][0]
    run = json.loads((block / "run.json").read_text())
    assert run["points"] == run["depth"] == "made@1" and len(run["sources"]) == 6
    assert {path.name.rpartition("-")[0] for path in (block / "pictures").iterdir()} == {
        "training-0", "training-1", "held-out-0", "held-out-1",
    }  # fmt: skip
    # A finished run is reported again, not trained again.
    stamp = (block / "model.safetensors").stat().st_mtime_ns
    assert said(capsys, *reconstruct(dataset, model)) == done
    assert (block / "model.safetensors").stat().st_mtime_ns == stamp

    protocol = narrow(tmp_path)
    submission = tmp_path / "submission"
    words = ("--dataset", dataset.root, "--split", "novel", "--protocol", protocol, "--out", submission)
    assert said(capsys, "render", model, *words)["method"] == "hybridworldsim"
    manifest = json.loads((submission / "manifest.json").read_text())
    assert manifest["appearance"]["policy"] == "nearest-traversal"
    assert manifest["runtime"]["model_bytes"] == done["model_bytes"]
    assert main(["submission", "check", dataset.root, str(submission), "--protocol", str(protocol)]) == 0
    capsys.readouterr()

    ply = tmp_path / "street.ply"
    baked = said(capsys, "export-ply", dataset.root, model, "--out", ply, "--degree", 1)
    assert baked["bytes"] == ply.stat().st_size and baked["gaussians"] > 100 and baked["psnr_db"] > 30.0

    drawn = driven_as_documented(dataset, model)
    assert drawn["image"].dtype == np.uint8 and drawn["image"].shape[:2] == tuple(drawn["rendering"].depth_m.shape)
    assert drawn["view"].camera == "front_left" and drawn["step"] == len(drawn["way"]) - 1 > 4

    # The nearest line is the oncoming one; the given one has another colour.
    shifted = ("--dataset", dataset.root, "--trajectory", "lane-shift:-1.0", "--width", 48, "--hz", 5)
    new = next(name for name in dataset.traversals() if ".new." in name)
    looks = {}
    for word in ("nearest", "mean", next(name for name in dataset.traversals() if ".near." in name)):
        out = tmp_path / f"pictures-{len(looks)}"
        cameras = ("--cameras", "front_wide", "--traversal", new, "--appearance", word)
        printed = said(capsys, "render", model, *shifted, *cameras, "--out", out)
        files = sorted(out.glob("front_wide/*.png"))
        assert len(files) == printed["pictures"] > 4
        looks[word] = np.mean([cv2.imread(str(file))[..., ::-1].mean((0, 1)) for file in files], axis=0)
    near, far = (next(name for name in dataset.traversals() if f".{word}." in name) for word in ("near", "far"))
    film = tmp_path / "street.mp4"
    swept = ("--cameras", "front_wide", "--traversal", new, "--appearance", f"sweep:{near}:{far}", "--out", film)
    printed = said(capsys, "render", model, *shifted, *swept)
    read = cv2.VideoCapture(str(film))
    frames = [read.read()[1] for _ in range(printed["pictures"])]
    assert len(frames) > 4 and frames[0].shape[1] == 48 and not read.read()[0]
    # It begins with a red look and ends with a green one.
    (_, green, red), (_, last_green, last_red) = (frames[place].mean((0, 1)) for place in (0, -1))
    assert last_green - last_red > green - red + 1.0
    out = tmp_path / "by-camera"
    both = ("--traversal", new, "--appearance", f"front_wide={near}")
    said(capsys, "render", model, *shifted, *both, "--out", out)
    for camera, same in (("front_wide", near), ("front_left", "nearest")):
        alone = tmp_path / camera
        words = ("--cameras", camera, "--traversal", new, "--appearance", same, "--out", alone)
        said(capsys, "render", model, *shifted, *words)
        files = sorted(alone.glob("*/*.png"))
        assert files and all((out / camera / file.name).read_bytes() == file.read_bytes() for file in files)
    for wrong in ("rear=night", "front_wide=", "front_wide=night,mean"):
        problem = said(capsys, "render", model, *shifted, "--appearance", wrong, "--out", tmp_path / "x", code=2)
        assert problem["expected"] == "CAMERA=POLICY,... of front_left, front_wide"
    of_split = ("--dataset", dataset.root, "--split", "novel", "--appearance", "front_wide=night")
    problem = said(capsys, "render", model, *of_split, "--out", tmp_path / "x", code=2)
    assert problem["problem"] == "appearances by camera are for trajectories"
    nearest, mean, given = looks.values()
    red, _, blue = given - nearest
    assert red > 1.0 and blue < -1.0
    # What a mixture of latents looks like is the network's to say: another thing than either.
    assert np.abs(mean - nearest).max() > 0.5 and np.abs(mean - given).max() > 0.5


def test_held_out_traversals_need_no_layers(dataset: Dataset, tmp_path: Path) -> None:
    chosen = dataset.with_layers(depth="made@1", points="made@1")
    task = ReconstructionTask("street", "novel", load_protocol(str(narrow(tmp_path))), steps=4, threads=1)
    done = installed_method("hybridworldsim").reconstruct(chosen, task, tmp_path / "model", NullProgress())
    assert done.steps == 4 and list((tmp_path / "model").glob("*/pictures/held-out-0-*.jpg"))


def narrow(folder: Path) -> Path:
    """The protocol in 48 pixels, by PSNR."""
    text = Path(mirror.__file__).parent.joinpath("protocols/definitions/static-reconstruction.toml").read_text()
    path = folder / "narrow.toml"
    path.write_text(text.replace("max_width_px = 960", "max_width_px = 48"))
    return path


def test_looks_are_fitted_to_the_left_half_and_said_to_be(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model"
    said(capsys, *reconstruct(dataset, model, "--steps", 12))
    psnr = {}
    for policy in ("nearest", "fit"):
        out = tmp_path / policy
        words = ("--dataset", dataset.root, "--split", "novel", "--protocol", narrow(tmp_path), "--out", out)
        said(capsys, "render", model, *words, "--appearance", policy)
        files = sorted(out.glob("renders/novel/*/front_wide/*.png"))
        psnr[policy] = np.mean([np.abs(cv2.imread(str(file))[:, 24:].astype(float) - 120).mean() for file in files])
    assert psnr["fit"] < 0.7 * psnr["nearest"]
    appearance = json.loads((tmp_path / "fit" / "manifest.json").read_text())["appearance"]
    assert appearance["policy"] == "fitted"


@pytest.mark.parametrize("method", ["vanilla_3dgs", "mtgs_style", "omnire_style"])
def test_rivals_go_through_the_same_verbs(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    model = tmp_path / "model"
    said(capsys, *reconstruct(dataset, model, "--method", method, "--steps", 6))
    words = ("render", dataset.root, model, "--trajectory", "forward:1", "--cameras", "front_wide")
    printed = said(capsys, *words, "--width", 48, "--hz", 2, "--out", tmp_path / "pictures")
    assert printed["method"] == method and printed["pictures"] == len(list((tmp_path / "pictures").rglob("*.png"))) > 1
    for mixed in ("mean", "sweep:day:day"):
        words_of = (*words, "--appearance", mixed, "--out", tmp_path / "mixed")
        assert f"{method} has no latents" in said(capsys, *words_of, code=ExitCode.COULD_NOT_RUN)["problem"]
        assert not (tmp_path / "mixed").exists()


@pytest.mark.parametrize(
    ("method", "more"),
    [("hybridworldsim", False), ("hybridworldsim_structure", True), ("hybridworldsim_light", False)],
)
def test_the_papers_method_has_the_papers_losses_and_the_other_one_more(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, more: bool
) -> None:
    model = tmp_path / "model"
    (block,) = said(capsys, *reconstruct(dataset, model, "--method", method, "--steps", 6))["blocks"]
    columns = (model / block / "curves.csv").read_text().splitlines()[0].split(",")
    assert "rgb" in columns and ("structure" in columns) == more
    weight = json.loads((model / block / "run.json").read_text())["settings"]["structure_weight"]
    assert (weight > 0.0) == more
    words = ("render", dataset.root, model, "--split", "novel", "--protocol", narrow(tmp_path))
    assert said(capsys, *words, "--out", tmp_path / "submission")["method"] == method


def test_headlights_go_off_where_a_model_has_some(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, lit = tmp_path / "plain", tmp_path / "lit"
    said(capsys, *reconstruct(dataset, plain, "--steps", 3))
    said(capsys, *reconstruct(dataset, lit, "--method", "hybridworldsim_light", "--steps", 12))
    words = ("--trajectory", "forward:1", "--cameras", "front_wide", "--width", 48, "--hz", 2, "--headlights", "off")
    printed = said(capsys, "render", dataset.root, lit, *words, "--out", tmp_path / "off")
    assert printed["pictures"] == len(list((tmp_path / "off").rglob("*.png"))) > 1
    refused = said(capsys, "render", dataset.root, plain, *words, "--out", tmp_path / "no", code=ExitCode.COULD_NOT_RUN)
    assert refused["place"] == "--headlights" and "hybridworldsim_light" in refused["remedy"]
    split = ("--split", "novel", "--protocol", narrow(tmp_path), "--headlights", "off", "--out", tmp_path / "no")
    refused = said(capsys, "render", dataset.root, lit, *split, code=ExitCode.COULD_NOT_RUN)
    assert refused["place"] == "--headlights" and not (tmp_path / "no").exists()


def test_where_no_bar_moves_each_report_is_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    for quiet, expected in ((False, "50 %\n"), (True, "")):
        with progress_bar(quiet=quiet) as watch:
            watch.start("training", 10)
            watch.status("5 dB")
            watch.advance(5)
            watch.report("50 %")
        assert capsys.readouterr() == ("", expected)


def test_on_a_terminal_the_bar_reports_and_notes_stay(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar(quiet=False) as watch:
        watch.start("training", 10)
        watch.report("50 %")
        watch.message("points [a@1] are not of b")
    drawn = capsys.readouterr().err
    assert "points [a@1] are not of b" in drawn and "50 %" not in drawn


@pytest.mark.parametrize("method", ["hybridworldsim", "vanilla_3dgs"])
def test_a_long_street_is_several_blocks(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hybridworldsim.methods.scene_preparation.divide", lambda driven, size_m: divide(driven, 16.0))
    model = tmp_path / "model"
    done = said(capsys, *reconstruct(dataset, model, "--method", method, "--steps", 4))
    assert len(done["blocks"]) > 1 and done["steps"] == 4 * len(done["blocks"])
    assert done["model_bytes"] == sum(file.stat().st_size for file in model.glob("*/model.safetensors"))
    words = ("render", dataset.root, model, "--split", "novel", "--protocol", narrow(tmp_path))
    assert said(capsys, *words, "--out", tmp_path / "submission")["views"] > 0
    (model / done["blocks"][1] / "outcome.json").unlink()
    undone = said(capsys, *words, "--out", tmp_path / "other", code=ExitCode.COULD_NOT_RUN)
    assert "1 blocks are not trained to the end" in undone["problem"]


def test_blocks_are_shared_out(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hybridworldsim.methods.scene_preparation.divide", lambda driven, size_m: divide(driven, 16.0))
    at_once, shared = tmp_path / "at-once", tmp_path / "shared"
    whole = said(capsys, *reconstruct(dataset, at_once, "--steps", 3))
    first, *others = whole["blocks"]
    begun = said(capsys, *reconstruct(dataset, shared, "--steps", 3, "--blocks", first))
    assert (begun["blocks"], begun["undone"], begun["steps"]) == ([first], others, 3)
    words = ("render", dataset.root, shared, "--split", "novel", "--out", tmp_path / "submission")
    assert "not trained to the end" in said(capsys, *words, code=ExitCode.COULD_NOT_RUN)["problem"]
    mixed = (*reconstruct(dataset, shared, "--steps", 3, "--blocks", ",".join(others)), "--seed", 7)
    assert "seed 0, now 7" in said(capsys, *mixed, code=ExitCode.COULD_NOT_RUN)["problem"]
    said(capsys, *reconstruct(dataset, shared, "--steps", 3, "--blocks", ",".join(others)))
    done = said(capsys, *reconstruct(dataset, shared, "--steps", 3))
    assert (done["blocks"], done["undone"]) == (whole["blocks"], [])
    for name in whole["blocks"]:
        model = f"{name}/model.safetensors"
        assert (shared / model).read_bytes() == (at_once / model).read_bytes()
    problem = said(
        capsys, *reconstruct(dataset, shared, "--steps", 3, "--blocks", "block_9"), code=ExitCode.COULD_NOT_RUN
    )
    assert "no block block_9" in problem["problem"] and first in problem["expected"]


def test_blocks_train_on_several_devices_as_on_one(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two processes on the CPU; the method of shorter blocks is in a file, and pickled by what it is made of.

    The executor has one process more: that several share items is tested in tests/executors.
    """
    (tmp_path / "short.py").write_text(
        "from dataclasses import replace\n"
        "from hybridworldsim.methods.street import METHOD as STREET\n"
        "METHOD = replace(STREET, block_m=16.0)\n"
    )
    method = ("--method", f"{tmp_path / 'short.py'}:METHOD", "--steps", 3)
    one = said(capsys, *reconstruct(dataset, tmp_path / "one", *method))
    words = list(map(str, reconstruct(dataset, tmp_path / "several", *method)))
    if "--device" in words:
        place = words.index("--device")
        del words[place : place + 2]
    several = said(capsys, *words, "--devices", "cpu,cpu")
    apart = said(capsys, *words[: words.index("--out") + 1], tmp_path / "apart", *words[words.index("--out") + 2 :],
                 "--executor", "processes", "--workers", 1)  # fmt: skip
    assert apart["blocks"] == one["blocks"]
    assert len(one["blocks"]) > 1 and several["blocks"] == one["blocks"] and several["steps"] == one["steps"]
    for name in one["blocks"]:
        model = f"{name}/model.safetensors"
        trained = {(tmp_path / folder / model).read_bytes() for folder in ("one", "several", "apart")}
        assert len(trained) == 1
    refused = said(capsys, *words, "--devices", "cpu,cpu", "--device", "cpu", code=ExitCode.COULD_NOT_RUN)
    assert "exclude each other" in refused["problem"]


def test_blocks_are_divided_by_their_images() -> None:
    assert divide_blocks({"a": 5, "b": 4, "c": 3, "d": 1}, ("cuda:0", "cuda:1")) == [
        ("cuda:0", frozenset("ad")), ("cuda:1", frozenset("bc"))
    ]  # fmt: skip
    assert divide_blocks({"a": 5}, ("cpu", "cpu")) == [("cpu", frozenset("a"))]


def test_layers_from_held_out_images_are_not_used_by_default(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def noted(dataset: Dataset, task: ReconstructionTask, progress: object) -> None:
        asked.append(layer_source(dataset, task))
        raise UsageError("enough")

    monkeypatch.setattr("hybridworldsim.methods.scene_preparation.layers_for", noted)
    for more in ((), ("--hold-out",), ("--hold-out", "--initialise", "dataset")):
        protocol = ("--protocol", narrow(tmp_path)) if more else ()
        said(capsys, *reconstruct(dataset, tmp_path / "model", *protocol, *more), code=ExitCode.COULD_NOT_RUN)
    assert asked == ["dataset", "plane-sweep", "dataset"]


def test_layers_that_were_made_for_a_split_are_not_taken_for_another_unasked(street: Dataset) -> None:  # noqa: F811
    """They are of its training traversals, one of which another split may hold out."""
    traversal = street.where(split="novel", role="train").traversals()[0]
    layout = Layout(Path(street.root))
    task = ReconstructionTask("street", "novel", load_protocol("static-reconstruction"))
    for source, expected in (("plane-sweep", "plane-sweep"), ("lidar", "dataset")):
        LayerWriter(layout, traversal, "points", source, "other-240").finish(POINTS, [point(0)], {})
        build_index(layout.root)
        assert layer_source(mirror.open(street.root), task) == expected
    # What was brought is chosen among the two.
    assert layers_for(mirror.open(street.root), task, NullProgress()).points == "lidar@other-240"


def test_a_layer_is_named_and_depth_of_another_is_not_read(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = Layout(Path(dataset.root))
    for traversal in dataset.where(split="novel", role="train").traversals():
        LayerWriter(layout, traversal, "points", "lidar", "2").finish(POINTS, [point(n) for n in range(50)], {})
    build_index(layout.root)
    words = reconstruct(mirror.open(dataset.root), tmp_path / "model", "--steps", 6)
    several = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert "2 layers of points: lidar@2, made@1" in several["problem"] and "SOURCE@VERSION" in several["remedy"]
    wrong = said(capsys, *words, "--initialise", "lidar@3", code=ExitCode.COULD_NOT_RUN)
    assert "lidar@3" in wrong["problem"] and "plane-sweep" in wrong["expected"] and "lidar@2" in wrong["expected"]
    done = said(capsys, *words, "--initialise", "lidar@2")
    assert done["points"] == "lidar@2"
    block = tmp_path / "model" / done["blocks"][0]
    run = json.loads((block / "run.json").read_text())
    assert (run["points"], run["depth"]) == ("lidar@2", None)
    assert "depth" not in (block / "curves.csv").read_text().splitlines()[0].split(",")


def test_a_model_is_not_tested_by_what_it_was_trained_on(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, splits = tmp_path / "model", Path(dataset.root) / "splits"
    said(capsys, *reconstruct(dataset, model, "--steps", 3))
    document = json.loads((splits / "novel.json").read_text())
    trained = read_reconstruction(model).trained
    assert trained == {key: "34" * 32 for key, role in document["assignments"].items() if role == "train"}
    first = min(trained)
    swapped = {**document, "name": "swapped", "assignments": {**document["assignments"], first: "held_out"}}
    changed = {**document, "name": "changed", "manifests": {**document["manifests"], first: "56" * 32}}
    none = {**document, "name": "none", "assignments": {}, "manifests": {}}
    words = ("render", dataset.root, model, "--protocol", narrow(tmp_path), "--out", tmp_path / "out")
    for split, message in (
        (swapped, f"the model was trained on {first}, which split swapped holds out"),
        (changed, f"the recorded data of {first} changed after the training"),
        (none, "split none has none of the 3 traversals that the model was trained on"),
    ):
        (splits / f"{split['name']}.json").write_text(json.dumps(split))
        assert message in said(capsys, *words, "--split", split["name"], code=ExitCode.COULD_NOT_RUN)["problem"]
    (splits / "novel.json").write_text(json.dumps({**changed, "name": "novel"}))
    ply = ("export-ply", dataset.root, model, "--out", tmp_path / "street.ply")
    shifted = ("render", dataset.root, model, "--trajectory", "forward:1", "--out", tmp_path / "out")
    for verb in (ply, shifted):
        assert "changed after the training" in said(capsys, *verb, code=ExitCode.COULD_NOT_RUN)["problem"]
    assert not (tmp_path / "out").exists() and not (tmp_path / "street.ply").exists()


def test_missing_held_out_image_does_not_stop_training(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held_out = dataset.where(split="novel", role="held_out")
    for name in held_out.table("images", ["uri"]).column(0).to_pylist():
        (Path(dataset.root) / name).unlink()
    words = reconstruct(dataset, tmp_path / "model", "--steps", 3)
    assert main([str(word) for word in words]) == ExitCode.DONE
    assert "not shown in the previews" in capsys.readouterr().err
    names = {path.name.rpartition("-")[0] for path in (tmp_path / "model").glob("*/pictures/*.jpg")}
    assert names == {"training-0", "training-1"}


def test_layers_that_were_chosen_stay_chosen_when_others_are_made(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hybridworldsim.methods.layers.initialise", lambda *_, **__: SimpleNamespace(layer="made@1"))
    (scene,) = dataset.where(split="novel", role="train").scenes()
    task = ReconstructionTask(
        scene=scene, split="novel", protocol=load_protocol(str(narrow(tmp_path))), initialise="plane-sweep"
    )
    layers = layers_for(dataset.with_layers(stage="online"), task, NullProgress())
    assert (layers.depth, layers.points) == ("made@1", "made@1")
    assert layers.dataset.layers == replace(dataset.layers, stage="online", depth="made@1", points="made@1")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--steps", 9), "a run of other settings began here: steps 3, now 9"),
        (("--steps", 3, "--seed", 5), "seed 0, now 5"),
        (("--steps", 3, "--fp16"), "half False, now True"),
        (("--steps", 3, "--width", 32), "width_px 48, now 32"),
    ],
)
def test_a_run_of_other_settings_is_refused(
    initialised: Dataset, model: Path, capsys: pytest.CaptureFixture[str], more: tuple[object, ...], message: str
) -> None:
    words = ("reconstruct", initialised.root, "--split", "novel", "--out", model, "--threads", 1)
    width = () if "--width" in more else ("--width", 48)
    layers = set(Path(initialised.root).rglob("manifest.json"))
    assert message in said(capsys, *words, *width, *more, code=ExitCode.COULD_NOT_RUN)["problem"]
    assert set(Path(initialised.root).rglob("manifest.json")) == layers, "a layer of the refused width was made"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--scene", "elsewhere"), "no training traversals in scene 'elsewhere'"),
        (("--method", "magic"), "no method 'magic' is installed"),
        (("--minutes", 1), "--minutes and --steps exclude each other"),
        (("--threads", 0), "0"),
        (("--seed", -1), "-1"),
        (("--split", "none"), "no such split"),
    ],
)
def test_what_cannot_be_is_refused(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[object, ...], message: str
) -> None:
    words = reconstruct(dataset, tmp_path / "model", *more)
    assert message in said(capsys, *words, code=ExitCode.COULD_NOT_RUN)["problem"]
    assert not (tmp_path / "model").exists()


def test_without_points_the_remedy_is_named(
    street: Dataset,  # noqa: F811
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = reconstruct(street, tmp_path / "model", "--initialise", "dataset")
    problem = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert "no points" in problem["problem"] and "--initialise plane-sweep" in problem["remedy"]


def test_another_folder_is_left_alone(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    problem = said(capsys, *reconstruct(dataset, tmp_path), code=ExitCode.COULD_NOT_RUN)["problem"]
    assert "a folder with other files" in problem
    problem = said(
        capsys, "render", dataset.root, tmp_path, "--split", "novel", "--out", tmp_path / "new",
        code=ExitCode.COULD_NOT_RUN,
    )  # fmt: skip
    assert problem["problem"] == "the folder has no reconstruction.json"


def test_a_layer_that_one_traversal_lacks_is_told_of_and_an_empty_one_is_read(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = Layout(Path(dataset.root))
    first, second, third = dataset.where(split="novel", role="train").traversals()
    LayerWriter(layout, first, "points", "lidar", "1").finish(POINTS, [point(n) for n in range(50)], {})
    LayerWriter(layout, second, "points", "lidar", "1").finish(POINTS, [], {})
    for traversal in (first, second):
        LayerWriter(layout, traversal, "depth", "lidar", "1").finish(DEPTH, [], {})
    build_index(layout.root)
    words = reconstruct(dataset, tmp_path / "model", "--steps", 9, "--initialise", "lidar@1")
    assert main([str(word) for word in words]) == ExitCode.DONE
    printed = capsys.readouterr().err
    assert f"without points: {third}\n" in printed and f"without depth: {third}\n" in printed
    chosen = mirror.open(dataset.root).with_layers(points="lidar@1")
    assert len(chosen.points()) == 50
    with pytest.raises(DatasetError, match="no points layer lidar@1"):
        chosen.where(traversal=third).points()


def test_settings_are_changed_by_name_and_written_down(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model"
    words = reconstruct(dataset, model, "--steps", 3, "--set", "depth_weight=0.5", "--set", "refinement.most=90")
    (block,) = said(capsys, *words)["blocks"]
    settings = json.loads((model / block / "run.json").read_text())["settings"]
    assert settings["depth_weight"] == 0.5 and settings["refinement"]["most"] == 90
    usual = said(capsys, *reconstruct(dataset, model, "--steps", 3), code=ExitCode.COULD_NOT_RUN)
    assert "settings.depth_weight 0.5, now 0.04" in usual["problem"]
    for wrong, place in (("depth_weight", "--set"), ("depth_weight=x", "--set depth_weight"), ("magic=1", "--set")):
        words = reconstruct(dataset, tmp_path / "other", "--set", wrong)
        assert said(capsys, *words, code=ExitCode.COULD_NOT_RUN)["place"] == place
    assert not (tmp_path / "other").exists()


def test_what_is_done_is_done_on_a_machine_with_other_processors(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = said(capsys, *reconstruct(dataset, tmp_path / "model", "--steps", 3))
    assert said(capsys, *reconstruct(dataset, tmp_path / "model", "--steps", 3, "--threads", 2)) == done
    (tmp_path / "model" / done["blocks"][0] / "outcome.json").unlink()
    words = reconstruct(dataset, tmp_path / "model", "--steps", 3, "--threads", 2)
    refused = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert "threads 1, now 2" in refused["problem"] and "--threads 1" in refused["remedy"]


def test_held_out_frames_of_training_traversals_are_not_trained_on(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = tmp_path / "alone.toml"
    novel = '[[groups]]\nname = "novel"\nroles = ["held_out", "test"]\n'
    text = narrow(tmp_path).read_text().replace(novel, "")
    alone.write_text(text.replace('groups = ["novel"]', 'groups = ["training"]'))
    said(capsys, *reconstruct(dataset, tmp_path / "model", "--steps", 3))
    words = ("--dataset", dataset.root, "--split", "novel", "--protocol", alone, "--out", tmp_path / "out")
    refused = said(capsys, "render", tmp_path / "model", *words, code=ExitCode.COULD_NOT_RUN)
    assert "trained on the images that protocol" in refused["problem"] and "--hold-out" in refused["remedy"]
    more = ("--steps", 3, "--hold-out", "--protocol", alone, "--initialise", "dataset")
    said(capsys, *reconstruct(dataset, tmp_path / "unseen", *more))
    assert said(capsys, "render", tmp_path / "unseen", *words)["views"] > 0
    # It has seen nothing of what is asked for, and all looks that are: there is nothing to fit.
    fit = said(
        capsys, "render", tmp_path / "unseen", *words[:-1], tmp_path / "fit", "--appearance", "fit",
        code=ExitCode.COULD_NOT_RUN,
    )  # fmt: skip
    assert "nothing to fit" in fit["problem"]


def test_protocol_with_distorted_images_is_refused_before_layers_are_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fisheye = make_street(tmp_path / "fisheye", ("front_wide", "rear"))
    protocol = narrow(tmp_path)
    protocol.write_text(protocol.read_text().replace('space = "undistorted"', 'space = "raw"'))
    words = reconstruct(
        fisheye, tmp_path / "model", "--initialise", "plane-sweep", "--protocol", protocol, "--hold-out"
    )
    refused = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert "a lens of model kannala_brandt" in refused["problem"] and not (tmp_path / "model").exists()
    assert not list(Path(fisheye.root).glob("traversals/*/layers/*/plane-sweep@*"))


def test_a_model_is_rendered_at_the_poses_that_it_was_trained_at(dataset: Dataset, tmp_path: Path) -> None:
    model = Reconstruction(
        method="hybridworldsim", scene="street", split="novel", poses="refined@1",
        trained=list_trained_traversals(dataset, "novel", "street"),
    )  # fmt: skip
    with pytest.raises(UsageError, match=r"poses refined@1, .* poses recorded"):
        require_matching_split(dataset, "novel", model)
    require_matching_split(dataset, "novel", model.model_copy(update={"poses": "recorded"}))


@pytest.mark.parametrize("where", ["split", "trajectory"])
def test_an_interrupted_rendering_goes_on_and_ends_the_same(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    model, out, whole = tmp_path / "model", tmp_path / "out", tmp_path / "whole"
    said(capsys, *reconstruct(dataset, model, "--steps", 3))
    asked = ("--split", "novel", "--protocol", narrow(tmp_path))
    if where == "trajectory":
        asked = ("--trajectory", "forward:1", "--width", 48, "--hz", 5)
    words = ("render", dataset.root, model, *asked)
    said(capsys, *words, "--out", whole)
    with interrupt_before("*.png", 6):
        assert main([str(word) for word in (*words, "--out", out)]) == 130
    kept = {path: path.stat().st_mtime_ns for path in out.rglob("*.png")}
    assert "run the same command again" in capsys.readouterr().err and not (out / "manifest.json").exists()
    other = said(capsys, *words, "--appearance", "mean", "--out", out, code=ExitCode.COULD_NOT_RUN)
    assert "an interrupted run with other settings" in other["problem"]
    said(capsys, *words, "--out", out)
    files = {path.relative_to(whole): path.read_bytes() for path in whole.rglob("*.png")}
    assert {path.relative_to(out): path.read_bytes() for path in out.rglob("*.png")} == files
    assert len(kept) == 5 and {path: path.stat().st_mtime_ns for path in kept} == kept
    assert not (out / ".rendering").exists()
    # Done is done: nothing goes on there.
    done = "it holds a submission already" if where == "split" else "a folder with other files"
    assert done in said(capsys, *words, "--out", out, code=ExitCode.COULD_NOT_RUN)["problem"]


def test_an_appearance_that_the_model_has_not_is_refused_and_leaves_nothing(
    initialised: Dataset, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ("render", initialised.root, model, "--split", "novel", "--appearance", "neon", "--out", out)
    assert said(capsys, *words, code=ExitCode.COULD_NOT_RUN)["place"] == "--appearance"
    assert not out.exists()


def test_a_block_of_which_all_is_masked_is_left_out_and_the_rest_is_whole(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hybridworldsim.methods.scene_preparation.divide", lambda driven, size_m: divide(driven, 16.0))
    usual, masked = TrainingImageCache.__call__, set[str]()

    def covered(images: TrainingImageCache, view: RenderView) -> TrainingImage:
        image = usual(images, view)
        return replace(image, scored=torch.zeros_like(image.scored)) if view.path in masked else image

    first = said(capsys, *reconstruct(dataset, tmp_path / "whole", "--steps", 2))["blocks"]
    gone = json.loads((tmp_path / "whole" / first[0] / "run.json").read_text())
    origin = np.array(gone["origin_m"])
    everything = training_views(dataset, load_protocol("static-reconstruction"), "novel", "street").views
    block = Block((0, 0), tuple(origin.tolist()), 16.0, 4.0)
    masked.update(one.path for one in select_views(block, everything))
    monkeypatch.setattr(TrainingImageCache, "__call__", covered)
    removed: list[str] = []

    def rmtree(folder: Path) -> None:
        # Nobody else may train there meanwhile: it would be another's run that is removed.
        with pytest.raises(DatasetError, match="another process"), lock_run(folder):
            pass
        removed.append(folder.name)
        shutil.rmtree(folder)

    monkeypatch.setattr("hybridworldsim.methods.static.shutil", SimpleNamespace(rmtree=rmtree))
    model = tmp_path / "model"
    capsys.readouterr()
    assert main([str(word) for word in reconstruct(dataset, model, "--steps", 2)]) == ExitCode.DONE
    printed = capsys.readouterr()
    assert removed == [first[0]]
    assert f"{first[0]} is left out: masks cover all its images" in printed.out + printed.err
    assert sorted(path.parent.name for path in model.glob("*/model.safetensors")) == sorted(first[1:])
    words = ("render", dataset.root, model, "--split", "novel", "--protocol", narrow(tmp_path))
    assert said(capsys, *words, "--out", tmp_path / "submission")["views"] > 0
    # It stays left out: nothing is tried again.
    masked.clear()
    assert said(capsys, *reconstruct(dataset, model, "--steps", 2))["blocks"] == first[1:]
    masked.update(one.path for one in select_views(block, everything))
    alone = reconstruct(dataset, tmp_path / "alone", "--steps", 2, "--blocks", first[0])
    assert said(capsys, *alone, code=ExitCode.COULD_NOT_RUN)["problem"] == "masks cover every training image"
    assert not (tmp_path / "alone" / first[0]).exists()
    masked.update(one.path for one in everything)
    nothing = said(capsys, *reconstruct(dataset, tmp_path / "none", "--steps", 2), code=ExitCode.COULD_NOT_RUN)
    assert nothing["problem"] == "masks cover every training image"


def test_points_that_are_no_numbers_are_refused_by_name(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    traversal = dataset.where(split="novel", role="train").traversals()[0]
    rows = [{**point(number), "x_m": math.inf if number == 3 else 1.0} for number in range(9)]
    LayerWriter(Layout(Path(dataset.root)), traversal, "points", "broken", "1").finish(POINTS, rows, {})
    build_index(Path(dataset.root))
    words = reconstruct(dataset, tmp_path / "model", "--initialise", "broken@1")
    refused = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert refused["problem"] == "1 of 9 points are not finite" and "broken@1" in refused["place"]
    assert not (tmp_path / "model").exists()


def test_views_that_nobody_took_are_a_submission_too(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, submission, protocol = tmp_path / "model", tmp_path / "submission", tmp_path / "aside.toml"
    protocols = Path(mirror.__file__).parent / "protocols" / "definitions"
    text = (protocols / "lane-shift.toml").read_text()
    protocol.write_text(text.replace("max_width_px = 960", "max_width_px = 48"))
    said(capsys, *reconstruct(dataset, model, "--steps", 12))
    asked = ("--dataset", dataset.root, "--split", "novel", "--protocol", protocol, "--out", submission)
    assert main([str(word) for word in ("render", model, *asked)]) == ExitCode.DONE
    shown = f"evaluate {dataset.root} {submission} --protocol {protocol} --hidden FOLDER\n"
    assert capsys.readouterr().out.endswith(shown)
    plan = plan_views(dataset, load_protocol(str(protocol)), "novel")
    assert len(plan.views) == len(list(submission.rglob("*.png"))) > 20
    assert {view.group for view in plan.views} == {f"{side}-{far}m" for side in ("left", "right") for far in (1, 2, 3)}
    # Where it stands is what is drawn.
    drawn = installed_method("hybridworldsim").open(model, AppearancePolicy(views=plan.views))
    for view in plan.views[:: len(plan.views) // 5]:
        np.testing.assert_array_equal(cv2.imread(str(submission / view.path))[..., ::-1], drawn(view))
    check = ("submission", "check", dataset.root, submission, "--protocol", protocol)
    assert main([str(word) for word in check]) == ExitCode.DONE


def test_what_renders_need_is_told(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--dataset", dataset.root, "--trajectory", "forward:1")
    error = said(capsys, "render", *words, "--out", tmp_path / "out", code=ExitCode.COULD_NOT_RUN)
    assert (error["problem"], error["place"]) == ("no model", "MODEL")
    error = said(capsys, "render", tmp_path / "m", *words, "--out", tmp_path / "out.avi", code=ExitCode.COULD_NOT_RUN)
    assert error["place"] == "--out" and ".mp4" in error["expected"]
    error = said(capsys, "render", tmp_path / "m", *words, "--out", tmp_path / "out", code=ExitCode.COULD_NOT_RUN)
    assert error["problem"] == "no such folder" and "mirror reconstruct" in error["expected"]


def test_a_block_that_there_is_not_is_refused_before_layers_are_made(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(path for path in Path(dataset.root).rglob("*"))
    words = reconstruct(dataset, tmp_path / "model", "--initialise", "plane-sweep", "--blocks", "block_99")
    error = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert error["place"] == "--blocks" and "block_00_00" in error["expected"]
    assert sorted(path for path in Path(dataset.root).rglob("*")) == before


def test_while_another_run_writes_it_the_dataset_is_read_as_it_was_before(dataset: Dataset) -> None:
    layout = Layout(Path(dataset.root))
    traversal = dataset.traversals()[0]
    LayerWriter(layout, traversal, "points", "late", "1").finish(POINTS, [], {})
    with writer_lock(layout, wait=False):
        assert mirror.open(dataset.root).index_sha256 == dataset.index_sha256
    assert mirror.open(dataset.root).index_sha256 == dataset.index_sha256


def test_a_scheduler_ends_it_as_ctrl_c_does(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with interrupt_before("*", number=signal.SIGTERM):
        assert main([str(word) for word in reconstruct(dataset, tmp_path / "model")]) == 130
    assert "run the same command again" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) == before


def test_few_points_are_warned_of(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    traversal = dataset.where(split="novel", role="train").traversals()[0]
    for count, version in ((49, "1"), (50, "2")):
        rows = [point(number) for number in range(count)]
        LayerWriter(Layout(Path(dataset.root)), traversal, "points", "sparse", version).finish(POINTS, rows, {})
        build_index(Path(dataset.root))
        words = reconstruct(dataset, tmp_path / version, "--initialise", f"sparse@{version}", "--steps", 1)
        assert main([str(word) for word in words]) == ExitCode.DONE
        printed = capsys.readouterr()
        assert ("warning: the scene has 49 points" in printed.out + printed.err) == (count == 49)


def tree(root: Path) -> dict[str, tuple[bytes, int]]:
    return {
        str(path.relative_to(root)): (path.read_bytes() if path.is_file() else b"", path.stat().st_mtime_ns)
        for path in (root, *sorted(root.rglob("*")))
    }


def test_a_dataset_that_is_only_read_stays_as_it_was(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, layers = tree(Path(dataset.root)), tmp_path / "layers"
    words = reconstruct(dataset, tmp_path / "model", "--layers", layers, "--steps", 2)
    # The fixture's images are noise: the layer is written, and has no points.
    assert "matched no point" in said(capsys, *words, "--initialise", "sparse", code=ExitCode.COULD_NOT_RUN)["remedy"]
    assert tree(Path(dataset.root)) == before
    copied = [name for row in mirror.open(layers).table("traversals").to_pylist() for name in row["layers"]]
    assert "points/sparse@novel-48" in copied and "points/made@1" in copied
    shutil.rmtree(tmp_path / "model", ignore_errors=True)
    done = said(capsys, *words, "--initialise", "made@1")
    # The same command again is done, and the model is rendered with the dataset itself.
    assert said(capsys, *words, "--initialise", "made@1")["steps"] == done["steps"] > 0
    render = ("render", dataset.root, tmp_path / "model", "--split", "novel", "--protocol", narrow(tmp_path))
    assert said(capsys, *render, "--out", tmp_path / "submission")["views"] > 0
    assert tree(Path(dataset.root)) == before
    other = shutil.copytree(dataset.root, tmp_path / "other")
    for folder in (Path(dataset.root), other):
        words = reconstruct(dataset, tmp_path / "more", "--layers", folder)
        assert said(capsys, *words, code=ExitCode.COULD_NOT_RUN)["place"] == "--layers"
    assert tree(Path(dataset.root)) == before and not (tmp_path / "more").exists()


def run_read_only(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run `mirror` where a folder is mounted read-only: root passes over permissions, and no write passes this."""
    mount = f"mount --bind {folder} {folder} && mount -o remount,ro,bind {folder}"
    if subprocess.run(["unshare", "-rm", "sh", "-c", mount], capture_output=True, check=False).returncode:
        pytest.skip("this system does not let this user mount in a namespace of its own")
    command = [sys.executable, "-m", "mirror.cli.main", *map(str, words)]
    mounted = ["unshare", "-rm", "sh", "-c", f'{mount} && exec "$@"', "sh", *command]
    return subprocess.run(mounted, capture_output=True, text=True, check=False)


def test_a_dataset_that_cannot_be_written_names_the_option_for_layers(dataset: Dataset, tmp_path: Path) -> None:
    root = Path(dataset.root)
    words = reconstruct(dataset, tmp_path / "model", "--steps", 1, "--initialise", "sparse")
    run = run_read_only(root, *words)
    assert run.returncode == ExitCode.COULD_NOT_RUN
    assert f"{root}" in run.stderr and "Read-only file system" in run.stderr
    assert "make the folder writable or choose another place with --layers FOLDER" in " ".join(run.stderr.split())
    # What the verb writes elsewhere is named by its own option.
    shut = tmp_path / "shut"
    shut.mkdir()
    run = run_read_only(shut, *reconstruct(dataset, shut / "model", "--steps", 1, "--initialise", "made@1"))
    assert run.returncode == ExitCode.COULD_NOT_RUN
    assert "name another place with --out" in " ".join(run.stderr.split())


def test_a_layer_of_boxes_is_chosen_with_an_option(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    traversal = dataset.where(split="novel", role="train").traversals()[0]
    LayerWriter(Layout(Path(dataset.root)), traversal, "boxes", "tracked", "1").finish(BOXES, [], {})
    build_index(Path(dataset.root))
    refused = said(capsys, *reconstruct(dataset, tmp_path / "model", "--steps", 1), code=ExitCode.COULD_NOT_RUN)
    assert refused["place"] == "--boxes" and "--boxes tracked@1" in refused["remedy"]
    said(capsys, *reconstruct(dataset, tmp_path / "model", "--steps", 1, "--boxes", "petr@1"))
