"""PETR: keys, parity with a slow reference in float64, codes of boxes, losses, export."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import mirror  # noqa: E402
from hybridworldsim.petr.annotator import ANNOTATOR, to_detections  # noqa: E402
from hybridworldsim.petr.boxes import decode_boxes, encode_boxes  # noqa: E402
from hybridworldsim.petr.checkpoint import load_strictly, read_checkpoint  # noqa: E402
from hybridworldsim.petr.detector import Petr  # noqa: E402
from hybridworldsim.petr.encoding import lid_depths, matrix_points, multiview_sine, query_sine  # noqa: E402
from hybridworldsim.petr.head import DetectionHead, HeadOutput, HeadSettings  # noqa: E402
from hybridworldsim.petr.loss import TrueBoxes, detection_loss, match, sigmoid_focal_loss  # noqa: E402
from hybridworldsim.petr.onnx import export_onnx  # noqa: E402
from hybridworldsim.petr.rig import EGO_SE3_LIDAR, InputRaster, projection_matrix  # noqa: E402
from mirror.annotation import annotate  # noqa: E402
from mirror.dataset.index.build import build_index  # noqa: E402
from mirror.errors import UsageError  # noqa: E402
from mirror.geometry import Poses  # noqa: E402
from tests.builders.dataset import Builder, Pass  # noqa: E402
from tests.petr import reference  # noqa: E402

SMALL = HeadSettings(classes=3, dim=16, queries=12, layers=2, heads=4, hidden=32, depths=8)


def projections(count: int) -> np.ndarray:
    """Cameras in a circle."""
    found = []
    for number in range(count):
        camera = InputRaster(64, 64).pinhole("front_wide")
        angle = 2 * math.pi * number / count
        forward, right = [math.cos(angle), math.sin(angle), 0.0], [math.sin(angle), -math.cos(angle), 0.0]
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack((right, [0.0, 0.0, -1.0], forward), axis=1)
        matrix[:3, 3] = 0.3 * np.array(forward)
        found.append(projection_matrix(camera, Poses.from_matrix(matrix).inverse()))
    return np.stack(found)


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint with the published names and random numbers, also in the statistics of the normalisations."""
    torch.manual_seed(0)
    network = Petr("vovnet99")
    state = network.state_dict()
    assert len(state) == 854
    assert state["img_backbone.stage4.OSA4_9.layers.4.OSA4_9_4/norm.running_var"].shape == (192,)
    assert state["pts_bbox_head.transformer.decoder.layers.5.ffns.0.layers.1.weight"].shape == (256, 2048)
    assert state["pts_bbox_head.cls_branches.5.6.weight"].shape == (10, 256)
    for name, value in state.items():
        if value.is_floating_point():
            spread = 0.02 if value.dim() < 2 else 1.2 / math.sqrt(value[0].numel())
            value.normal_(0.0, spread)
            if name.endswith(("norm.weight", "running_var")) or re.search(r"norms?\.\d?\.?weight", name):
                value.add_(1.0)
    # The branches of all layers are one module.
    for layer in range(6):
        for branch in ("cls_branches", "reg_branches"):
            for name in [key for key in state if f"{branch}.0." in key]:
                state[name.replace(f"{branch}.0.", f"{branch}.{layer}.")].copy_(state[name])
    state["pts_bbox_head.reference_points.weight"].uniform_(0.0, 1.0)
    file = tmp_path_factory.mktemp("petr") / "petr.pth"
    torch.save({"state_dict": state, "meta": {"mmdet3d_version": "0.17.1"}}, file)
    return file


def test_a_published_checkpoint_gives_the_output_of_the_reference(published: Path) -> None:
    checkpoint = read_checkpoint(published)
    state = checkpoint.state
    torch.manual_seed(1)
    assert (checkpoint.generation, checkpoint.backbone, checkpoint.multiview) == ("width-length", "vovnet99", True)
    loaded = Petr("vovnet99")
    load_strictly(loaded, checkpoint)
    loaded.double().eval()
    images = torch.randn(2, 3, 64, 64, dtype=torch.float64)
    cameras = projections(2)
    points = matrix_points(torch.from_numpy(cameras), 4, 4, (64, 64), loaded.depths.double())
    loaded.pts_bbox_head.float().double()
    with torch.no_grad():
        out = loaded(images[None], points[None])
    wide = {name: value.double() for name, value in state.items()}
    logits, codes = reference.petr(wide, images, cameras)
    assert float(logits.std()) > 1e-3
    # The ranges of the head are float32 numbers.
    torch.testing.assert_close(out.logits[-1, 0], logits, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(out.codes[-1, 0], codes, rtol=1e-5, atol=1e-5)


def test_frames_of_a_rig_become_a_layer(published: Path, tmp_path: Path) -> None:
    import cv2

    image = cv2.imencode(".jpg", np.full((32, 48, 3), 90, np.uint8))[1].tobytes()
    cameras = ("main", "front_right", "front_left", "rear", "rear_left", "rear_right", "front_narrow")
    builder = Builder(tmp_path / "dataset", cameras=cameras)
    builder.scene("a")
    missing = frozenset([("rear", 1)])
    builder.drive("d0", [Pass("a", frames=2, images=dict.fromkeys(cameras, image), dropped=missing)])
    build_index(builder.root)
    dataset = mirror.open(builder.root)
    settings = {"weights": str(published), "min_score": "0.0", "raster": "64x64", "cameras": "front_wide:main"}
    report = annotate(dataset, ANNOTATOR.open(dataset, settings, "cpu"), skip_failed=True)
    # The second frame lacks the image of a direction.
    assert "no image of rear (rear)" in report.failed[0].reason
    assert 0 < report.boxes <= 300
    frame = mirror.open(builder.root).frames()[0]
    boxes = frame.boxes()
    assert len(boxes) == report.boxes
    assert np.linalg.norm(boxes.pose.translation[:, :2], axis=1).max() < 90.0
    for settings, message in (
        ({"cameras": "side:x"}, "cameras"),
        ({"raster": "65x64"}, "raster"),
        ({"min_score": "2"}, "score"),
    ):
        with pytest.raises(UsageError, match=message):
            ANNOTATOR.open(dataset, {"weights": str(published), **settings}, "cpu")
    if not torch.cuda.is_available():
        with pytest.raises(UsageError, match="CUDA"):
            ANNOTATOR.open(dataset, {"weights": str(published)}, "cuda")


def test_encodings_agree_with_loops_in_float64() -> None:
    cameras = projections(3)
    points = matrix_points(torch.from_numpy(cameras), 2, 3, (64, 64), lid_depths(64, 1.0, 61.2, dtype=torch.float64))
    head = DetectionHead(HeadSettings(queries=5, layers=1), 4).double()
    from hybridworldsim.petr.encoding import encode_points

    limits = torch.tensor((-61.2, -61.2, -10.0, 61.2, 61.2, 10.0), dtype=torch.float64)
    torch.testing.assert_close(
        encode_points(points, limits), reference.position_input(cameras, 2, 3, (64, 64)), rtol=0, atol=1e-9
    )
    sine = multiview_sine(3, 2, 3, 128, dtype=torch.float64)
    torch.testing.assert_close(sine, reference.sine_input(3, 2, 3), rtol=0, atol=1e-12)
    places = head.reference_points.weight.detach()
    torch.testing.assert_close(query_sine(places, 128), reference.query_input(places), rtol=0, atol=1e-12)


@pytest.mark.parametrize("generation", ["width-length", "length-width"])
def test_codes_of_boxes_round_trip_in_both_generations(generation: str) -> None:
    generator = torch.Generator().manual_seed(3)
    yaw = torch.tensor([0.0, 1.0, 3.0, -2.5, -1.6])
    centre = torch.rand(5, 3, generator=generator) * 10
    size = torch.rand(5, 3, generator=generator) * 3 + torch.tensor([4.0, 0.5, 1.0])
    velocity = torch.randn(5, 2, generator=generator)
    code = encode_boxes(centre, size, yaw, velocity, generation)  # type: ignore[arg-type]
    # Width comes first in the old generation.
    first = size[:, 1] if generation == "width-length" else size[:, 0]
    torch.testing.assert_close(code[:, 2].exp(), first)
    logits = torch.full((5, 2), -9.0)
    logits[torch.arange(5), torch.tensor([0, 1, 0, 1, 0])] = torch.tensor([5.0, 4.0, 3.0, 2.0, -0.5])
    output = HeadOutput(logits[None, None], code[None, None])
    boxes = decode_boxes(output, generation, min_score=0.5)[0]  # type: ignore[arg-type]
    # The fifth has a lower score than asked for.
    for name, expected in (("centre_m", centre), ("size_m", size), ("yaw_rad", yaw), ("velocity_mps", velocity)):
        torch.testing.assert_close(getattr(boxes, name), expected[:4])
    assert boxes.label.tolist() == [0, 1, 0, 1]


def test_boxes_reach_the_ego_frame() -> None:
    """A car ahead of the lidar that drives forward: x right, y forward there; x forward, y left here."""
    code = encode_boxes(
        torch.tensor([[2.0, 10.0, -1.0]]), torch.tensor([[4.0, 2.0, 1.5]]), torch.tensor([math.pi / 2]),
        torch.tensor([[0.0, 5.0]]), "length-width",
    )  # fmt: skip
    output = HeadOutput(torch.tensor([[[[3.0]]]]), code[None, None])
    found = to_detections(decode_boxes(output, "length-width")[0], 7)
    np.testing.assert_allclose(found.ego_SE3_box.translation[0], (10.943713, -2.0, 0.84023), atol=1e-6)
    np.testing.assert_allclose(np.abs(found.ego_SE3_box.rotation[0]), (1, 0, 0, 0), atol=1e-6)
    np.testing.assert_allclose(found.velocity_mps[0], (5.0, 0.0, 0.0), atol=1e-6)
    assert (found.category, found.timestamp_ns, EGO_SE3_LIDAR.translation[0, 2]) == (("car",), 7, 1.84023)


@pytest.mark.parametrize(
    ("meta", "expected"),
    [({"mmdet3d_version": "1.0.0rc1"}, "length-width"), ({"mmengine_version": "0.5"}, "length-width"),
     ({"mmdet3d_version": "0.18.1"}, "width-length"), ({}, None)],
)  # fmt: skip
def test_the_generation_is_read_or_asked_for(tmp_path: Path, meta: dict[str, str], expected: str | None) -> None:
    file = tmp_path / "weights.pth"
    torch.save({"state_dict": {"a": torch.zeros(1)}, "meta": meta}, file)
    if expected is None:
        with pytest.raises(UsageError, match="does not state"):
            read_checkpoint(file)
        assert read_checkpoint(file, generation="length-width").generation == "length-width"
    else:
        assert read_checkpoint(file).generation == expected


def test_checkpoints_that_do_not_fit_are_refused_by_key(tmp_path: Path) -> None:
    network = DetectionHead(SMALL, 4)
    file = tmp_path / "weights.pth"
    state = dict(network.state_dict())
    removed = "input_proj.bias"
    state.pop(removed)
    state["conv_offset"] = torch.zeros(1)
    state["query_embedding.0.bias"] = torch.zeros(3)
    state["query_embedding.2.bias"] = torch.full((16,), torch.nan)
    torch.save({"state_dict": state, "meta": {"mmdet3d_version": "1.1"}}, file)
    with pytest.raises(UsageError, match=r"input_proj\.bias.*conv_offset"):
        load_strictly(network, read_checkpoint(file))
    with pytest.raises(UsageError, match="sha256"):
        read_checkpoint(file, sha256="0" * 64)
    file.write_bytes(b"no checkpoint")
    with pytest.raises(UsageError, match="cannot be read"):
        read_checkpoint(file)
    with pytest.raises(UsageError, match="no such file"):
        read_checkpoint(tmp_path / "absent.pth")
    for settings, message in (
        ({}, "no weights"),
        ({"weights": "x", "generation": "3"}, "generation"),
        ({"weights": "x", "speed": "3"}, "no setting"),
    ):
        with pytest.raises(UsageError, match=message):
            ANNOTATOR.open(None, settings, "cpu")  # type: ignore[arg-type]


def test_old_names_of_the_transformer_are_renamed(tmp_path: Path) -> None:
    file = tmp_path / "weights.pth"
    names = ("decoder.layers.0.self_attn.out_proj.bias", "decoder.layers.0.multihead_attn.attn.out_proj.bias",
             "decoder.norm.weight")  # fmt: skip
    torch.save({f"pts_bbox_head.transformer.{name}": torch.zeros(1) for name in names}, file)
    expected = ("decoder.layers.0.attentions.0.attn.out_proj.bias", "decoder.layers.0.attentions.1.attn.out_proj.bias",
                "decoder.post_norm.weight")  # fmt: skip
    state = read_checkpoint(file, generation="length-width").state
    assert set(state) == {f"pts_bbox_head.transformer.{name}" for name in expected}


def test_losses_against_plain_formulas() -> None:
    generator = torch.Generator().manual_seed(1)
    logits, code = torch.randn(6, 3, generator=generator), torch.randn(6, 10, generator=generator)
    truth = TrueBoxes(torch.tensor([2, 0]), torch.randn(2, 10, generator=generator))
    truth.code[1, 8:] = torch.nan
    rows, columns = match(logits, code, truth)
    best = None
    for one in range(6):
        for other in range(6):
            if one == other:
                continue
            cost = 0.0
            for query, true in ((one, 0), (other, 1)):
                p = float(logits[query, truth.label[true]].sigmoid())
                cost += 2 * (-0.25 * (1 - p) ** 2 * math.log(p) + 0.75 * p**2 * math.log(1 - p))
                cost += 0.25 * float((code[query, :8] - truth.code[true, :8]).abs().sum())
            if best is None or cost < best[0]:
                best = (cost, {0: one, 1: other})
    assert best is not None
    assert {int(c): int(r) for r, c in zip(rows, columns)} == best[1]
    p = 1 / (1 + math.exp(-0.7))
    focal = sigmoid_focal_loss(torch.tensor([0.7, 0.7]), torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(
        focal, torch.tensor([-0.25 * (1 - p) ** 2 * math.log(p), -0.75 * p**2 * math.log(1 - p)])
    )
    output = HeadOutput(logits[None, None].requires_grad_(), code[None, None].requires_grad_())
    weights = torch.tensor([1.0] * 8 + [0.2] * 2)
    losses = detection_loss(output, [truth], weights)
    expected = sum(float(((code[r] - truth.code[c]).abs() * weights).nan_to_num().sum()) for r, c in zip(rows, columns))
    assert float(losses["box"].detach()) == pytest.approx(0.25 * expected / 2, rel=1e-6)
    sum(losses.values()).backward()
    assert bool(torch.isfinite(output.codes.grad).all())
    nothing = detection_loss(output, [TrueBoxes(torch.empty(0, dtype=torch.long), torch.empty(0, 10))], weights)
    assert float(nothing["box"].detach()) == 0.0


class Whole(torch.nn.Module):
    """A head behind one convolution."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone, self.head = torch.nn.Conv2d(3, 4, 8, 8), DetectionHead(SMALL, 4)

    def forward(self, images: torch.Tensor, points: torch.Tensor) -> HeadOutput:
        return self.head(self.backbone(images.flatten(0, 1)).unflatten(0, images.shape[:2]), points)


def test_any_number_of_cameras_and_training_reduces_the_loss() -> None:
    torch.manual_seed(0)
    network = Whole()
    assert network(torch.randn(1, 1, 3, 16, 24), torch.randn(1, 1, 2, 3, 8, 3)).codes.shape == (2, 1, 12, 10)
    images, points = torch.randn(1, 5, 3, 16, 24), torch.randn(1, 5, 2, 3, 8, 3) * 20
    truth = TrueBoxes(torch.tensor([1]), torch.tensor([[5.0, -8.0, 1.4, 0.6, -1.0, 0.4, 0.0, 1.0, 1.0, 0.0]]))
    optimizer = torch.optim.AdamW(network.parameters(), 3e-3)
    values = []
    for _ in range(60):
        loss = sum(detection_loss(network(images, points), [truth], network.head.code_weights).values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        values.append(float(loss.detach()))
    assert np.mean(values[-5:]) < 0.3 * np.mean(values[:5])


def test_the_exported_network_gives_the_same_boxes(tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    torch.manual_seed(0)
    network = Whole().eval()
    images, points = torch.randn(1, 3, 3, 16, 24), torch.randn(1, 3, 2, 3, 8, 3) * 20
    file = tmp_path / "petr.onnx"
    export_onnx(network, images, points, file)
    session = runtime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    images, points = torch.randn_like(images), torch.randn_like(points) * 20
    logits, codes = session.run(None, {"images": images.numpy(), "points": points.numpy()})
    with torch.no_grad():
        expected = network(images, points)
    np.testing.assert_allclose(logits, expected.logits[-1].numpy(), atol=1e-4)
    np.testing.assert_allclose(codes, expected.codes[-1].numpy(), atol=1e-4)
