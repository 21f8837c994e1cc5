"""The tiny PETR: rays, targets, losses, training that resumes bit for bit, the model's file, the annotator."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from tests.interruption import InterruptingProgress

torch = pytest.importorskip("torch")

import mirror  # noqa: E402
from hybridworldsim.petr.boxes import DecodedBoxes  # noqa: E402
from hybridworldsim.petr.tiny.annotator import ANNOTATOR, SHIPPED, TinyAnnotator  # noqa: E402
from hybridworldsim.petr.tiny.dense import LOG_SIZE, DenseOutput, decode_cells, ray_pitch  # noqa: E402
from hybridworldsim.petr.tiny.detect import find_boxes, without_doubles  # noqa: E402
from hybridworldsim.petr.tiny.loss import dense_loss  # noqa: E402
from hybridworldsim.petr.tiny.model_file import read_model, write_model  # noqa: E402
from hybridworldsim.petr.tiny.network import STRIDE, TinyPetr  # noqa: E402
from hybridworldsim.petr.tiny.run import train_on_samples  # noqa: E402
from hybridworldsim.petr.tiny.samples import CameraInput, Sample, TargetBoxes, camera_input, read_sample  # noqa: E402
from hybridworldsim.petr.tiny.settings import (  # noqa: E402
    CLASS_OF,
    CLASSES,
    NetworkSettings,
    TrainingSettings,
    training_settings,
)
from hybridworldsim.petr.tiny.trainer import TinyTrainer, batch_boxes  # noqa: E402
from mirror.annotation.detections import AnnotationError  # noqa: E402
from mirror.annotation.protocol import TrainingTask  # noqa: E402
from mirror.cli.main import main  # noqa: E402
from mirror.dataset.dataset import Dataset  # noqa: E402
from mirror.errors import UsageError  # noqa: E402
from mirror.progress import NullProgress  # noqa: E402
from mirror.schema.scenario import AgentCategory  # noqa: E402

SETTINGS = NetworkSettings()
SMALL = NetworkSettings(
    width_px=64, height_px=32, channels=(4, 8, 8, 8), dim=16, hidden=16, depths=4, queries=5, proposals=4
)


@pytest.fixture(scope="module")
def samples(tiny_dataset: Dataset) -> list[Sample]:
    return [read_sample(frame, SETTINGS, 45.0) for frame in tiny_dataset.frames()[:3]]


def task(steps: int, **more: object) -> TrainingTask:
    return replace(TrainingTask(steps, None, 3, 1, {}), **more)  # type: ignore[arg-type]


def test_rays_pass_through_their_tokens_in_every_lens(tiny_dataset: Dataset) -> None:
    frame = tiny_dataset.frames()[0]
    rig = camera_input(frame, SETTINGS)
    assert rig.images.shape == (len(frame.images), SETTINGS.height_px, SETTINGS.width_px, 3)
    row, column = 6, 17
    for place, image in enumerate(frame.images.values()):
        point = rig.origins[place].astype(np.float64) + 7.0 * rig.directions[place, row, column]
        in_camera = image.world_SE3_camera.inverse().transform(frame.world_SE3_ego.transform(point[None])[0])
        seen = image.camera_model.project(in_camera.reshape(1, 3))
        share = seen.uv_px[0] / (image.width_px, image.height_px)
        expected = ((column + 0.5) * STRIDE / SETTINGS.width_px, (row + 0.5) * STRIDE / SETTINGS.height_px)
        np.testing.assert_allclose(share, expected, atol=1e-4)


def test_middles_of_boxes_are_at_their_cells(tiny_dataset: Dataset, samples: list[Sample]) -> None:
    seen = 0
    for sample in samples:
        boxes, rig = sample.boxes, sample.cameras
        for box, place in np.argwhere(~np.isnan(boxes.cell[..., 0])):
            column, row = boxes.cell[box, place]
            ray = rig.directions[place, int(row), int(column)]
            toward = boxes.centre_m[box] - rig.origins[place]
            angle = math.acos(min(1.0, float(ray @ toward / np.linalg.norm(toward))))
            pitch = float(ray_pitch(torch.from_numpy(rig.directions[place][None]))[0, int(row), int(column)])
            # Half a token in both directions, with some room for lenses that stretch the rows.
            assert angle <= 1.2 * pitch
            seen += 1
    assert seen > 10


def exact_output(samples: list[Sample], box: int, camera: int) -> tuple[DenseOutput, tuple[int, int]]:
    """Outputs of the dense head that describe one box exactly at its own cell, computed in float64."""
    boxes, rig = samples[0].boxes, samples[0].cameras
    column, row = (int(value) for value in boxes.cell[box, camera])
    directions = torch.from_numpy(rig.directions).double()
    pitch = ray_pitch(directions)
    shape = directions.shape[:3]
    offset = boxes.centre_m[box].astype(np.float64) - rig.origins[camera]
    distance = np.linalg.norm(offset)
    azimuth, elevation = math.atan2(offset[1], offset[0]), math.asin(offset[2] / distance)
    x, y, z = rig.directions[camera, row, column].astype(np.float64)
    here = float(pitch[camera, row, column])
    relative = float(boxes.yaw_rad[box]) - azimuth
    values = {
        "logits": torch.full((*shape, len(CLASSES)), -9.0).double(),
        "log_distance": torch.full(shape, math.log(distance * here)).double(),
        "shift": torch.tensor([(azimuth - math.atan2(y, x)) / here, (elevation - math.asin(z)) / here]).expand(
            *shape, 2
        ),
        "log_size": (torch.from_numpy(boxes.size_m[box]).double().log() - torch.tensor(LOG_SIZE)).expand(*shape, 3),
        "heading": torch.tensor([math.sin(relative), math.cos(relative)]).expand(*shape, 2),
        "direction": directions,
        "origin": torch.from_numpy(rig.origins).double()[:, None, None].expand(*shape, 3),
        "pitch": pitch,
    }
    return DenseOutput(**{name: value[None].double() for name, value in values.items()}), (row, column)


def test_every_road_user_of_a_scenario_has_a_class() -> None:
    assert set(CLASS_OF.values()) == set(CLASSES)
    assert {*get_args(AgentCategory), "bicycle"} <= set(CLASS_OF)


def test_cells_decode_to_the_boxes_that_they_describe(samples: list[Sample]) -> None:
    boxes = samples[0].boxes
    for box, camera in np.argwhere(~np.isnan(boxes.cell[..., 0]))[:8]:
        dense, (row, column) = exact_output(samples, box, camera)
        code = decode_cells(dense).code[0, camera, row, column].numpy()
        np.testing.assert_allclose(code[[0, 1, 4]], boxes.centre_m[box], atol=2e-5)
        np.testing.assert_allclose(np.exp(code[[2, 3, 5]]), boxes.size_m[box], rtol=1e-5)
        yaw = -math.atan2(code[6], code[7]) - 0.5 * math.pi
        assert abs(math.remainder(yaw - float(boxes.yaw_rad[box]), 2 * math.pi)) < 1e-5


def test_the_dense_loss_of_exact_outputs_is_zero_at_their_cells(samples: list[Sample]) -> None:
    boxes = samples[0].boxes
    box, camera = np.argwhere(~np.isnan(boxes.cell[..., 0]))[0]
    cell = np.full_like(boxes.cell, np.nan)
    cell[box, camera] = boxes.cell[box, camera]
    # So narrow that its own cell alone belongs to the box.
    alone = replace(samples[0], boxes=replace(boxes, cell=cell, spread=np.full_like(boxes.spread, 0.05)))
    truth = batch_boxes([alone], np.zeros(1))
    dense, (row, column) = exact_output(samples, box, camera)
    logits = dense.logits.clone()
    logits[0, camera, row, column, boxes.label[box]] = 9.0
    losses = dense_loss(replace(dense, logits=logits), truth)
    for name in ("distance", "angles", "size", "heading", "heat"):
        assert float(losses[name]) < 1e-3, name
    wrong = dense_loss(replace(dense, logits=logits, log_distance=dense.log_distance + math.log(2.0)), truth)
    # Huber with a corner at 0.1: 2 (log 2 - 0.05).
    assert float(wrong["distance"]) == pytest.approx(2.0 * (math.log(2.0) - 0.05), abs=1e-4)
    elsewhere = torch.roll(logits, 3, dims=3)
    assert float(dense_loss(replace(dense, logits=elsewhere), truth)["heat"]) > 3.0


def test_the_dense_head_turns_with_the_vehicle() -> None:
    torch.manual_seed(0)
    network = TinyPetr(SMALL).double().eval()
    angle = 0.7
    cos, sin = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    features = torch.randn(2, SMALL.dim, 4, 8).double()
    directions = torch.nn.functional.normalize(torch.randn(2, 4, 8, 3).double(), dim=-1)
    origins = torch.tensor([[1.0, 0.2, 1.5], [-0.5, 0.0, 1.2]]).double()
    still, _ = network.dense_head(features, directions, origins)
    turned, _ = network.dense_head(features, directions @ turn.T, origins @ turn.T)
    one, other = decode_cells(still).code, decode_cells(turned).code
    torch.testing.assert_close(other[..., [0, 1, 4]], one[..., [0, 1, 4]] @ turn.T, atol=1e-9, rtol=0)
    difference = torch.atan2(one[..., 6], one[..., 7]) - torch.atan2(other[..., 6], other[..., 7])
    assert torch.allclose(torch.cos(difference - angle), torch.ones(()).double())


def test_training_lowers_the_loss_and_finds_what_it_has_seen(samples: list[Sample]) -> None:
    trainer = TinyTrainer(samples[:1], SETTINGS, TrainingSettings(batch=1, warmup=5, turn_deg=0.0, ema=0.9), 0)
    losses = [trainer.step(number, number / 60)["loss"] for number in range(60)]
    assert np.mean(losses[-5:]) < 0.3 * np.mean(losses[:5])
    found = find_boxes(trainer.averaged.eval(), samples[0].cameras, min_score=0.2)
    boxes = samples[0].boxes
    near = [row for row in range(len(boxes.label)) if np.hypot(*boxes.centre_m[row, :2]) < 20.0]
    away = torch.cdist(torch.from_numpy(boxes.centre_m[near]), found.centre_m).min(1).values
    assert float((away < 2.0).float().mean()) > 0.6


def test_an_interrupted_run_continues_bit_for_bit(samples: list[Sample], tmp_path: Path) -> None:
    settings = TrainingSettings(batch=2)
    whole = train_on_samples(samples, settings, task(3), tmp_path / "whole", NullProgress())
    with pytest.raises(KeyboardInterrupt):
        train_on_samples(samples, settings, task(3), tmp_path / "parts", InterruptingProgress(2))
    assert (tmp_path / "parts" / "checkpoint.safetensors").exists()
    parts = train_on_samples(samples, settings, task(3), tmp_path / "parts", NullProgress())
    assert parts.sha256 == whole.sha256
    assert parts.loss == whole.loss
    assert train_on_samples(samples, settings, task(3), tmp_path / "parts", NullProgress()) == parts
    other = train_on_samples(samples, settings, task(3, seed=4), tmp_path / "other", NullProgress())
    assert other.sha256 != whole.sha256
    with pytest.raises(UsageError, match="seed 3, now 4"):
        train_on_samples(samples, settings, task(3, seed=4), tmp_path / "parts", NullProgress())


def test_frames_with_other_numbers_of_cameras_and_without_boxes_are_trained_on(samples: list[Sample]) -> None:
    def of(cameras: int, boxes: slice) -> Sample:
        rig, old = samples[0].cameras, samples[0].boxes
        return Sample(
            CameraInput(rig.images[:cameras], rig.directions[:cameras], rig.origins[:cameras]),
            TargetBoxes(
                old.label[boxes], old.centre_m[boxes], old.size_m[boxes], old.yaw_rad[boxes],
                old.cell[boxes, :cameras], old.spread[boxes, :cameras],
            ),
        )  # fmt: skip

    mixed = [of(7, slice(None)), of(1, slice(None)), of(3, slice(0)), of(7, slice(1))]
    trainer = TinyTrainer(mixed, SETTINGS, TrainingSettings(), 0)
    for number in range(4):
        assert all(math.isfinite(value) for value in trainer.step(number, 0.0).values())


def test_the_model_file_holds_the_network_in_half_precision(tmp_path: Path) -> None:
    torch.manual_seed(1)
    network = TinyPetr(SMALL)
    size = write_model(tmp_path / "m.safetensors", network)
    assert size == (tmp_path / "m.safetensors").stat().st_size
    back, digest = read_model(tmp_path / "m.safetensors")
    assert back.settings == SMALL
    for name, value in back.state_dict().items():
        torch.testing.assert_close(value, network.state_dict()[name], atol=1e-3, rtol=1e-3)
    assert read_model(tmp_path / "m.safetensors", sha256=digest)[1] == digest
    write_model(tmp_path / "again.safetensors", network)
    assert (tmp_path / "again.safetensors").read_bytes() == (tmp_path / "m.safetensors").read_bytes()


def test_wrong_models_are_refused(tmp_path: Path) -> None:
    network = TinyPetr(SMALL)
    path = tmp_path / "m.safetensors"
    write_model(path, network)
    with pytest.raises(UsageError, match="sha256"):
        read_model(path, sha256="0" * 64)
    with pytest.raises(UsageError, match="no such file"):
        read_model(tmp_path / "absent.safetensors")
    (tmp_path / "half.safetensors").write_bytes(path.read_bytes()[:500])
    with pytest.raises(UsageError, match="cannot be read"):
        read_model(tmp_path / "half.safetensors")
    other = path.read_bytes().replace(b"mirror-petr-tiny/1", b"mirror-petr-tiny/9")
    (tmp_path / "other.safetensors").write_bytes(other)
    with pytest.raises(UsageError, match="mirror-petr-tiny/9"):
        read_model(tmp_path / "other.safetensors")
    with torch.no_grad():
        network.reference_points.fill_(math.nan)
    write_model(path, network)
    with pytest.raises(UsageError, match="reference_points is not finite"):
        read_model(path)


def test_boxes_on_a_better_one_of_their_class_are_left_out() -> None:
    boxes = DecodedBoxes(
        torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]),
        torch.tensor([[4.0, 2.0, 1.5]]).expand(4, 3),
        torch.zeros(4), torch.zeros(4, 2), torch.tensor([0, 0, 1, 0]), torch.tensor([0.9, 0.8, 0.7, 0.6]),
    )  # fmt: skip
    assert without_doubles(boxes).score.tolist() == pytest.approx([0.9, 0.7, 0.6])
    nothing = DecodedBoxes(*(value[:0] for value in vars(boxes).values()))
    assert len(without_doubles(nothing).score) == 0


def test_outputs_that_are_not_finite_fail_by_frame(tiny_dataset: Dataset) -> None:
    network = TinyPetr(SETTINGS).eval()
    with torch.no_grad():
        network.backbone.lateral.weight.fill_(math.nan)
    with pytest.raises(AnnotationError, match="not finite"):
        TinyAnnotator(network, "0" * 64, "cpu", 0.2).annotate(tiny_dataset.frames()[0])


@pytest.mark.parametrize("cameras", [("rear",), ("rear_left", "front_wide")])
def test_rigs_with_fewer_cameras_are_annotated(tiny_dataset: Dataset, cameras: tuple[str, ...]) -> None:
    torch.manual_seed(2)
    annotator = TinyAnnotator(TinyPetr(SETTINGS).eval(), "0" * 64, "cpu", 0.0)
    frame = tiny_dataset.where(camera=cameras).frames()[0]
    assert set(frame.images) == set(cameras)
    found = annotator.annotate(frame)
    assert len(found) > 0
    assert np.isfinite(found.ego_SE3_box.translation).all()
    assert np.isnan(found.velocity_mps).all()
    again = annotator.annotate(frame)
    np.testing.assert_array_equal(again.ego_SE3_box.translation, found.ego_SE3_box.translation)


def test_a_frame_without_images_fails_by_name(tiny_dataset: Dataset) -> None:
    frame = tiny_dataset.frames()[0]
    empty = SimpleNamespace(images={}, frame_index=frame.frame_index)
    with pytest.raises(AnnotationError, match="no image"):
        camera_input(empty, SETTINGS)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "message"), [({"lr": "1"}, "no setting 'lr'"), ({"ema": "1"}, "1"), ({"batch": "0"}, "0")]
)
def test_wrong_training_settings_are_refused(given: dict[str, str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        training_settings(given)


def test_train_then_annotate_by_the_command_line(
    one_drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = one_drive
    run = tmp_path / "run"
    words = ["annotate", "train", str(root), "--annotator", "petr-tiny", "--steps", "2", "--out", str(run)]
    assert main([*words, "--set", "batch=2", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["steps"] == 2
    assert report["frames"] == len(mirror.open(root).frames())
    assert {"run.json", "outcome.json", "curves.csv", "model.safetensors"} <= {path.name for path in run.iterdir()}
    # A finished run with other options is not changed.
    others = [{"2": "3"}.get(word, word) for word in words]
    assert main([*others, "--set", "batch=2"]) == 2
    assert "steps 2, now 3" in capsys.readouterr().err
    model = str(run / "model.safetensors")
    assert main(["annotate", str(root), "--annotator", "petr-tiny", "--set", f"weights={model}", "--json"]) == 0
    layer = json.loads(capsys.readouterr().out)["layer"]
    assert layer == f"petr-tiny@{report['sha256'][:8]}"
    assert main(["annotate", "train", str(root), "--annotator", "file", "--out", str(tmp_path / "x")]) == 2
    assert "cannot be trained" in capsys.readouterr().err
    assert main([*words, "--boxes", "none@1"]) == 2
    assert "no layer of boxes" in capsys.readouterr().err
    assert main([*words, "--minutes", "1"]) == 2
    assert "exclude each other" in capsys.readouterr().err
    assert main(["annotate", "train", "--annotator", "petr-tiny", "--out", str(run)]) == 2
    assert "no dataset" in capsys.readouterr().err


def test_the_installed_network_finds_cars_in_a_street_that_it_has_not_seen(tiny_dataset: Dataset) -> None:
    assert SHIPPED.stat().st_size < 3_000_000
    annotator = ANNOTATOR.open(tiny_dataset, {}, "cpu")
    found = true = hits = 0
    for frame in tiny_dataset.frames():
        exact, boxes = frame.boxes(), annotator.annotate(frame)
        cars = [row for row, name in enumerate(exact.category) if name in ("car", "van")]
        near = [row for row in cars if np.hypot(*exact.pose.translation[row, :2]) <= 15.0]
        seen = [row for row, name in enumerate(boxes.category) if name == "car"]
        places = boxes.ego_SE3_box.translation[seen, :2]
        true += len(near)
        found += int((np.hypot(*places.T) <= 15.0).sum()) if len(seen) else 0
        if len(near) and len(seen):
            away = np.linalg.norm(exact.pose.translation[near, None, :2] - places[None], axis=2)
            hits += int((away.min(axis=1) < 3.0).sum())
    # Boxes at random places would find one in fifty.
    assert true > 10
    assert hits > 0.6 * true
    assert found < 2 * true
