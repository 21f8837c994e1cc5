"""From a dataset to generated frames: clips, backgrounds, edits, segments that resume, and submissions."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

import mirror
from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.map_lines import MapLine
from hybridworldsim.generation.command import main
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, views_with_boxes
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.layout.images import draw_layout
from hybridworldsim.generation.model_files import read_generator
from hybridworldsim.generation.scenes import planned_views
from hybridworldsim.generation.scenes import run as run_module
from hybridworldsim.generation.scenes.backgrounds import calibrations_of, open_background
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles, open_generator
from hybridworldsim.generation.scenes.plan import plan_scene
from hybridworldsim.generation.scenes.planned_views import PlannedScenes, render_plan
from hybridworldsim.generation.scenes.rig import SceneRig, rig_of
from hybridworldsim.generation.scenes.rollout import SceneGenerator, roll_out_sequence
from hybridworldsim.generation.scenes.run import PIXELS, SceneRequest, generate_scene
from hybridworldsim.generation.scenes.scene_clip import PlannedFrame, SceneConditions, boxes_of, make_scene_clip
from hybridworldsim.generation.scenes.scene_edits import apply_edits, parse_edit, require_shown
from hybridworldsim.generation.scenes.submission import SubmissionRequest, generate_submission
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.geometry import Poses, project_boxes
from mirror.methods.model_document import DOCUMENT, Reconstruction
from mirror.metrics import psnr
from mirror.protocols.document import load_protocol
from mirror.protocols.views import Plan, plan_views
from mirror.protocols.views.view import Edit, RenderView, to_pose
from mirror.schema.files import write_json
from mirror.schema.tables import BOXES, CALIBRATIONS
from tests.generation.builders import make_network
from tests.generation.clips import make_clip
from tests.generation.trained import CODEC, NETWORK, T
from tests.interruption import interrupt_before

SIZE = (16, 24)
CAMERAS = ("front_wide", "front_left")
FIXED = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def rig(dataset: Dataset, traversal: str, size: tuple[int, int] = SIZE) -> SceneRig:
    return rig_of(dataset.where(traversal=traversal).frames(), CAMERAS, size, PIXELS)


def grey(view: RenderView) -> np.ndarray:
    return np.full((view.height_px, view.width_px, 3), 90, np.uint8)


def scene_of(dataset: Dataset, traversal: str, count: int = 6, trajectory: str | None = None):
    plan = plan_scene(dataset, traversal, hz=None, trajectory=trajectory, references=5, count=count)

    scene = SceneConditions(rig(dataset, traversal), grey, plan.rate_hz, plan.light, plan.weather, plan.tracks)
    return plan, scene


def test_boxes_land_where_the_dataset_shows_them(tiny_dataset: Dataset, traversal: str) -> None:
    """A box projected through the clip's lens lies where it lies through the recorded lens, undistorted."""
    plan, scene = scene_of(tiny_dataset, traversal)
    clip = make_scene_clip("c", plan.frames, scene, recorded=5)
    assert clip.images[:5].any() and not clip.images[5:].any()
    numbers = {number: name for name, number in plan.tracks.items()}
    compared = 0
    for place, one in enumerate(plan.frames):
        boxes = clip.boxes.at(place)
        for row, camera in enumerate(CAMERAS):
            image = one.frame.images.get(camera)
            if image is None:
                continue
            recorded = one.frame.boxes("world")
            lens = scene.rig.rasters[row].final
            for box in range(len(boxes)):
                track = numbers[int(boxes.track[box])]
                at = recorded.track_id.index(track)
                truth = image.world_SE3_camera.inverse() @ recorded.pose[np.array([at])]
                ours = mirror.geometry.Poses.from_matrix(
                    np.linalg.inv(clip.ego_SE3_camera[row]) @ boxes.ego_SE3_box[box : box + 1]
                )
                if truth.translation[0, 2] < 3.0:
                    continue
                pair = [project_boxes(lens, pose, recorded.size_m[[at]]) for pose in (ours, truth)]
                if not all(one.visible[0] for one in pair):
                    continue
                # Cameras expose up to a tenth of a second apart; the clip has one instant.
                assert np.abs(pair[0].bounds_px - pair[1].bounds_px).max() < 1.5
                compared += 1
    assert compared > 5


def test_seeds_are_recorded_images_in_the_raster_of_the_generator(tiny_dataset: Dataset, traversal: str) -> None:
    plan, scene = scene_of(tiny_dataset, traversal)
    clip = make_scene_clip("c", plan.frames, scene, recorded=5)
    height, width = SIZE
    for row, camera in enumerate(CAMERAS):
        image = plan.frames[2].frame.images[camera]
        full = scene.rig.rasters[row].full
        pixels = image.decode()
        if full != image.camera_model:
            maps = image.camera_model.undistort_maps(full)
            pixels = cv2.remap(pixels, *maps, cv2.INTER_LINEAR)
        expected = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
        street = scene.rig.images(plan.frames[2].frame)[1][row]
        assert street.mean() > 0.3
        assert np.abs(clip.images[2, row].astype(int) - expected)[street].max() <= 1
        # Elsewhere, outside a fisheye's image and on the recording vehicle, the seed is its background.
        np.testing.assert_array_equal(clip.images[2, row][~street], 90)


def test_the_exact_street_is_that_of_the_recording_without_road_users(tiny_dataset: Dataset, traversal: str) -> None:
    plan, scene = scene_of(tiny_dataset, traversal)
    background, _ = open_background("exact:tiny", tiny_dataset, "nearest", [])
    one = plan.frames[3]
    recorded, street = scene.rig.images(one.frame)
    for row, view in enumerate(scene.rig.views(one.frame, one.world_SE3_ego, plan.light, plan.weather)):
        empty = cv2.resize(background(view), SIZE[::-1], interpolation=cv2.INTER_AREA)
        # Road users, noise and errors of pose are left; another street has 12 dB.
        assert psnr(empty, recorded[row], mask=street[row]) > 16.0


def test_trajectories_move_the_generated_frames_only(tiny_dataset: Dataset, traversal: str) -> None:
    recorded, _ = scene_of(tiny_dataset, traversal)
    moved, _ = scene_of(tiny_dataset, traversal, trajectory="lane-shift:2.0")
    for place, (one, other) in enumerate(zip(recorded.frames, moved.frames)):
        shift = (one.world_SE3_ego.inverse() @ other.world_SE3_ego).translation[0]
        np.testing.assert_allclose(shift, [0.0, 2.0 if place >= 5 else 0.0, 0.0], atol=1e-6)


def test_edits_move_remove_and_add(tiny_dataset: Dataset, traversal: str) -> None:
    plan, scene = scene_of(tiny_dataset, traversal)
    clip = make_scene_clip("c", plan.frames, scene, recorded=0)
    numbers = {number: name for name, number in plan.tracks.items()}
    track = numbers[int(clip.boxes.track[0])]
    start = plan.frames[0].world_SE3_ego

    def edited(text: str):
        driven_m = np.array([[500.0, 0.0, 9.0], [2.0, -3.0, 0.5], [-40.0, 0.0, 7.0]])
        return apply_edits(clip, [parse_edit(text, plan.tracks)], plan.tracks, start, driven_m).boxes

    rows = clip.boxes.track == plan.tracks[track]
    moved = edited(f"move:{track}:dy=1.5,dx=-2")
    own = np.linalg.inv(clip.boxes.ego_SE3_box[rows]) @ moved.ego_SE3_box[rows]
    np.testing.assert_allclose(own[:, :3, 3], np.tile([-2.0, 1.5, 0.0], (rows.sum(), 1)), atol=1e-9)
    np.testing.assert_array_equal(moved.ego_SE3_box[~rows], clip.boxes.ego_SE3_box[~rows])
    assert plan.tracks[track] not in edited(f"remove:{track}").track
    added = edited("add:bus:at=3.0,-4.0,90")
    new = added.track == added.track.max()
    assert new.sum() == len(plan.frames)
    world = start.matrix()[0] @ clip.start_SE3_ego[2] @ added.ego_SE3_box[new][2]
    np.testing.assert_allclose(world[:3, 3], [3.0, -4.0, 0.5 + 3.1 / 2], atol=1e-9)
    np.testing.assert_allclose(world[:3, 0], [0.0, 1.0, 0.0], atol=1e-9)


def test_an_added_road_user_stays_in_place_on_a_slope() -> None:
    """Each segment of a scene is a clip of its own: the height is that of the nearest driven place in all of them."""
    clip = make_clip()
    driven_m = np.array([[x, 0.0, 0.05 * x] for x in np.arange(0.0, 100.0, 2.0)])
    edit = parse_edit("add:car:at=60,3,0", {})
    for first in (0, 16, 32):
        start = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), driven_m[[first]])
        boxes = apply_edits(clip, [edit], {}, start, driven_m).boxes
        added = boxes.at(0).ego_SE3_box[boxes.at(0).track == boxes.track.max()][0]
        world = start.matrix()[0] @ clip.start_SE3_ego[0] @ added
        np.testing.assert_allclose(world[:3, 3], [60.0, 3.0, 3.0 + 1.5 / 2], atol=1e-9)


def test_a_clip_has_the_lines_of_the_map_near_its_frames(tiny_dataset: Dataset, traversal: str) -> None:
    """Lines of the whole scene are not drawn for each view; what the frames show is the same."""
    plan, scene = scene_of(tiny_dataset, traversal)
    middle = plan.frames[3].world_SE3_ego.translation[0]
    shapes = [np.array([[-40.0, 3.0, 0.0], [40.0, 3.0, 0.0]]), np.array([[0.0, 3000.0, 0.0], [9.0, 3000.0, 0.0]])]
    near, far = (MapLine("lane", middle + points) for points in shapes)
    images = []
    for lines in ((near, far), (near,)):
        clip = make_scene_clip("c", plan.frames, replace(scene, lines=lines), recorded=0)
        assert clip.lines is not None and len(clip.lines) == 1
        images.append(
            draw_layout(
                clip.boxes.at(3), clip.intrinsics, clip.ego_SE3_camera, SIZE, OWN_STYLE, lines=clip.lines,
                ego_SE3_line=np.linalg.inv(clip.start_SE3_ego[3]),
            )
        )  # fmt: skip
    assert images[0][:, -3:].any()
    np.testing.assert_array_equal(*images)


def test_a_wrong_edit_is_named_before_the_generator_is_read(
    tiny_dataset: Dataset, models: Path, traversal: str, tmp_path: Path
) -> None:
    # Files that say what they are and have no tensors.
    for part in ("generator", "autoencoder"):
        with safe_open(models / part / "model.safetensors", framework="pt") as file:
            said = file.metadata()
        (tmp_path / "empty" / part).mkdir(parents=True)
        save_file({}, tmp_path / "empty" / part / "model.safetensors", metadata=said)
    models = tmp_path / "empty"
    with pytest.raises(UsageError, match="no track 'nobody'"):
        wrong = request(models, tiny_dataset, traversal, edits=("remove:nobody",))
        generate_scene(tiny_dataset, wrong, tmp_path / "out")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError) as caught:
        generate_scene(tiny_dataset, request(models, tiny_dataset, traversal), tmp_path)
    assert caught.value.place == "--out"
    with pytest.raises(DatasetError, match=r"empty/.*model\.safetensors"):
        generate_scene(tiny_dataset, request(models, tiny_dataset, traversal), tmp_path / "out")


@pytest.mark.parametrize(
    "text",
    ["", "move", "move:1", "remove:1:dy=2", "turn:1:dy=2", "move:1:dz=2", "move:1:dy=far", "move:1:dy=nan",
     "move:nobody:dy=1", "add:tank:at=1,2,3", "add:car:at=1,2", "add:car:by=1,2,3"],
)  # fmt: skip
def test_wrong_edits_are_refused_by_name(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_edit(text, {"1": 0})
    assert caught.value.place == "--edit"


def request(models: Path, dataset: Dataset, name: str, **changes: object) -> SceneRequest:
    scene = dataset.where(traversal=name).scenes()[0]
    plain = SceneRequest(
        GeneratorFiles(
            models / "generator" / "model.safetensors",
            models / "autoencoder" / "model.safetensors",
        ),
        scene=scene,
        background="exact:tiny",
        traversal=name,
        cameras=CAMERAS,
        size_px=SIZE,
        frames=5,
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def digest(folder: Path) -> dict[str, str]:
    return {
        file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted((folder / "frames").rglob("*.png"))
    }


@pytest.mark.parametrize(
    "device",
    ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)],
)
def test_an_interrupted_run_continues_bit_for_bit(
    tiny_dataset: Dataset, traversal: str, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: str
) -> None:
    # The last segment is shorter than T.
    monkeypatch.setattr("hybridworldsim.generation.scenes.rollout.SEGMENT", 2)
    wanted = request(models, tiny_dataset, traversal, device=device)
    document = generate_scene(tiny_dataset, wanted, tmp_path / "whole")
    assert document.frames == 5 and document.generated_views + document.kept_views == 10
    assert len(digest(tmp_path / "whole")) == 10
    played = cv2.VideoCapture(str(tmp_path / "whole" / "video.mp4"))
    for number in range(5):
        files = [tmp_path / "whole" / "frames" / camera / f"{number:05d}.png" for camera in CAMERAS]
        row = np.concatenate([cv2.imread(str(file)) for file in files], axis=1)
        found, image = played.read()
        # Measured 4 grey levels: the video is compressed.
        assert found and np.abs(image.astype(int) - row).mean() < 10.0
    assert not played.read()[0]
    with interrupt_before("*.png", 8):
        generate_scene(tiny_dataset, wanted, tmp_path / "part")
    again = generate_scene(tiny_dataset, wanted, tmp_path / "part")
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")
    assert (again.generated_views, again.kept_views) == (document.generated_views, document.kept_views)
    with pytest.raises(UsageError, match="it holds a scene of `mirror generate` already"):
        generate_scene(tiny_dataset, wanted, tmp_path / "part")


def test_another_request_is_refused_in_an_interrupted_folder(
    tiny_dataset: Dataset, traversal: str, models: Path, tmp_path: Path
) -> None:
    with interrupt_before("*.png"):
        generate_scene(tiny_dataset, request(models, tiny_dataset, traversal), tmp_path / "out")
    with pytest.raises(UsageError, match="other settings"):
        generate_scene(tiny_dataset, request(models, tiny_dataset, traversal, hz=0.25), tmp_path / "out")


def test_a_removed_road_user_leaves_views_that_cost_nothing(
    tiny_dataset: Dataset, traversal: str, models: Path, tmp_path: Path
) -> None:
    plan, _ = scene_of(tiny_dataset, traversal)
    removed = tuple(f"remove:{name}" for name in plan.tracks)
    document = generate_scene(
        tiny_dataset, request(models, tiny_dataset, traversal, edits=removed, frames=2), tmp_path / "out"
    )
    assert (document.generated_views, document.kept_views) == (0, 4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"size_px": (17, 24)}, "--size: images of 24 x 17 px; expected multiples of 8 px along both sides"),
        ({"size_px": (512, 24)}, "--size: images of 24 x 512 px; expected .* at most 256 px"),
        ({"cameras": ("front_wide", "front_wide")}, "--cameras: .* expected each camera once"),
        ({"trajectory": "lane_shift:2"}, "--trajectory: no trajectory 'lane_shift:2'"),
        ({"edits": ("move:nobody:dy=1",)}, "--edit: no track 'nobody'"),
        ({"hz": 30.0}, "--hz: 30 frames per second; expected at most 0.5"),
        ({"cameras": ("nose",)}, "no camera nose"),
        ({"traversal": None, "scene": "nowhere"}, "unknown scene 'nowhere'"),
        ({"background": "exact:"}, "exact:PRESET"),
        ({"background": "exact:nowhere"}, "no preset 'nowhere'"),
        ({"background": "exact:block"}, "not of preset 'block' with seed 0: it has no such drive"),
        ({"background": "exact:tiny:1"}, "not of preset 'tiny' with seed 1: its vehicle is"),
        ({"hz": 0.0}, "0.0 frames per second"),
        ({"hz": float("nan")}, "nan frames per second"),
        ({"frames": 0}, "0 frames"),
        ({"threads": 0}, "0 threads"),
        ({"background": "files:nowhere"}, "no such folder of backgrounds"),
        ({"background": "exact:tiny", "appearance": "night"}, "'night'"),
        ({"background": "nowhere"}, "nowhere"),
        ({"hz": 0.05}, "seed the rollout"),
        ({"device": "banana"}, "no device 'banana'"),
    ],
)
def test_bad_requests_are_refused_before_anything_is_written(
    tiny_dataset: Dataset, traversal: str, models: Path, tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises((UsageError, DatasetError), match=words):
        generate_scene(tiny_dataset, request(models, tiny_dataset, traversal, **changes), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_autoencoder_of_another_model_is_refused(models: Path, tmp_path: Path) -> None:
    network, _ = read_generator(models / "generator" / "model.safetensors")
    from hybridworldsim.generation.autoencoder.tiny import TinySettings
    from hybridworldsim.generation.model_files import write_autoencoder

    torch.manual_seed(0)
    other = TinyAutoencoder(TinySettings(channels=network.config.latent_channels // 2))
    write_autoencoder(tmp_path / "other.safetensors", other)
    with pytest.raises(DatasetError, match="the generator takes") as caught:
        open_generator(models / "generator" / "model.safetensors", tmp_path / "other.safetensors")
    assert (caught.value.file, caught.value.place) == (str(tmp_path / "other.safetensors"), "--autoencoder")


def test_weights_of_another_program_are_refused_with_the_way_to_load_them(models: Path, tmp_path: Path) -> None:
    autoencoder = models / "autoencoder" / "model.safetensors"
    torch.save({"a": torch.zeros(1)}, tmp_path / "released.pth")
    save_file({"a": torch.zeros(1)}, tmp_path / "released.safetensors")
    for name, message in (("released.pth", "cannot be read"), ("released.safetensors", "state no format")):
        with pytest.raises(DatasetError, match=message) as caught:
            open_generator(tmp_path / name, autoencoder)
        assert caught.value.file == str(tmp_path / name)
        assert "--base NAME --vae FOLDER" in str(caught.value.remedy)


def test_each_background_of_a_sequence_is_rendered_once(
    tiny_dataset: Dataset, traversal: str, models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also that of references of a later segment, and of a seed that stands several times."""
    monkeypatch.setattr("hybridworldsim.generation.scenes.rollout.SEGMENT", 2)
    plan, scene = scene_of(tiny_dataset, traversal)
    asked: list[str] = []

    def counted(view: RenderView) -> np.ndarray:
        asked.append(view.path)
        return np.full((view.height_px, view.width_px, 3), len(asked) % 251, np.uint8)

    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    generator, scene = open_generator(*files), replace(scene, background=counted)
    frames = [*[plan.frames[0]] * 5, *plan.frames[:5]]
    list(roll_out_sequence(generator, frames, scene, ClipRolloutOptions(), recorded_seeds=False))
    assert len(asked) == len(set(asked)) == 5 * len(CAMERAS)


def test_seeds_of_the_empty_street_show_no_box(tiny_dataset: Dataset, traversal: str) -> None:
    """They seed as frames do whose road users are all removed, to the bit; recorded seeds keep their boxes."""
    plan, scene = scene_of(tiny_dataset, traversal)
    generator = SceneGenerator(make_network(NETWORK).float(), TinyAutoencoder(CODEC), T)
    clip = make_scene_clip("c", plan.frames, scene, recorded=0)
    first = plan.frames[next(place for place in range(len(clip)) if views_with_boxes(clip, place).all())]
    boxes = first.frame.boxes("world")
    removed = tuple(
        Edit(track_id=name, category=kind, size_m=(1, 1, 1), world_SE3_box=FIXED, world_SE3_target=None)
        for name, kind in zip(boxes.track_id, boxes.category)
    )
    empty = PlannedFrame(first.frame, first.world_SE3_ego, removed)

    def generated(seed: PlannedFrame, recorded: bool) -> torch.Tensor:
        options = ClipRolloutOptions(SamplerSettings(1))
        ((frame, _),) = roll_out_sequence(generator, [seed] * T + [first], scene, options, recorded_seeds=recorded)
        return frame.latents

    assert torch.equal(generated(first, False), generated(empty, False))
    assert not torch.equal(generated(first, True), generated(empty, True))


def test_a_move_that_changes_no_frame_is_refused(tiny_dataset: Dataset, traversal: str) -> None:
    plan, _ = scene_of(tiny_dataset, traversal)
    boxes = boxes_of(plan.frames[5:], plan.tracks)
    numbers = {number: name for name, number in plan.tracks.items()}
    there = numbers[int(boxes.track[0])]
    gone = next(name for name, number in plan.tracks.items() if not (boxes.track == number).any())
    require_shown([parse_edit(f"move:{there}:dy=1", plan.tracks)], boxes, plan.tracks)
    require_shown([parse_edit(f"remove:{gone}", plan.tracks)], boxes, plan.tracks)
    with pytest.raises(UsageError, match=f"--edit: track '{gone}' has no box in the generated frames"):
        require_shown([parse_edit(f"move:{gone}:dy=1", plan.tracks)], boxes, plan.tracks)
    both = [parse_edit(f"{text}", plan.tracks) for text in (f"remove:{there}", f"move:{there}:dy=1")]
    with pytest.raises(UsageError, match=f"track '{there}' is moved after it is removed"):
        require_shown(both, boxes, plan.tracks)


@pytest.fixture(scope="module")
def broken(tiny_dataset: Dataset, traversal: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset with layers of boxes in which one row, far behind the first frames, is not valid."""
    root = tmp_path_factory.mktemp("broken") / "dataset"
    shutil.copytree(tiny_dataset.root, root, copy_function=os.link)
    table = tiny_dataset.where(traversal=traversal).table("boxes")
    rows = [{name: row[name] for name in BOXES.schema.names} for row in table.to_pylist()]
    # Boxes are recorded more often than frames: one that the last frame with boxes shows.
    shown = [one.boxes() for one in tiny_dataset.where(traversal=traversal).frames()]
    stamp = next(one.timestamp_ns for one in reversed(shown) if len(one))
    last = next(place for place, row in enumerate(rows) if row["timestamp_ns"] == stamp)
    for name, changes in (("lost", {"tx_m": np.nan}), ("flat", {"height_m": 0.0})):
        own = [{**row, "source": name, "source_version": "1"} for row in rows]
        own[last] |= changes
        LayerWriter(Layout(root), traversal, "boxes", name, "1").finish(BOXES, own, {})
    build_index(root)
    return root


@pytest.mark.parametrize(("layer", "message"), [("lost", "is not finite"), ("flat", "is not valid")])
def test_boxes_that_are_not_valid_are_named_before_a_frame_is_generated(
    broken: Path, traversal: str, models: Path, tmp_path: Path, layer: str, message: str
) -> None:
    words = ["scene", str(broken), str(models), "--background", "exact:tiny", "--size", "24x16"]
    words += ["--traversal", traversal, "--boxes", f"{layer}@1", "--out", str(tmp_path / "out")]
    with pytest.raises((DatasetError, UsageError), match=message) as caught:
        main(words)
    assert caught.value.file == str(broken) and caught.value.remedy
    assert f"boxes {layer}@1 of {traversal}, timestamp_ns " in str(caught.value.place)
    assert not (tmp_path / "out").exists()


def test_a_submission_to_the_protocol_of_edits(
    tiny_dataset: Dataset, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three groups of few frames: every view is there, in its own raster."""
    text = (Path(mirror.__file__).parent / "protocols" / "definitions" / "editing-accuracy-small.toml").read_text()
    text, _, rest = text.partition("[frames]")
    begin, *groups = text.split("[[groups]]")
    ranking = 'groups = ["right-3m", "right-2m", "left-2m", "left-3m"]'
    assert ranking in rest
    rest = "[frames]" + rest.replace("every = 5", "every = 10").replace(ranking, 'groups = ["left-2m"]')
    chosen = [group for group in groups if '"background"' in group or '"0m"' in group or '"left-2m"' in group]
    (tmp_path / "edits.toml").write_text(begin + "[[groups]]".join(["", *chosen]) + rest)
    plan = plan_views(tiny_dataset, load_protocol(str(tmp_path / "edits.toml")), "novel")
    assert plan.views
    words = ["scene", str(tiny_dataset.root), str(models), "--background", "exact:tiny", "--split", "novel"]
    words += ["--protocol", str(tmp_path / "edits.toml"), "--size", "24x16", "--out", str(tmp_path / "out")]
    assert main([*words, "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["views"] == len(plan.views)
    # Every tenth frame of one in two seconds.
    notes = json.loads((tmp_path / "out" / "manifest.json").read_text())["notes"]
    assert notes.startswith("frames are generated at 0.05 Hz, the generator was trained at 5 Hz")
    found = {view.path: cv2.imread(str(tmp_path / "out" / view.path)) for view in plan.views}
    assert all(
        image.shape == (view.height_px, view.width_px, 3)
        for view, image in zip(plan.views, found.values(), strict=True)
    )
    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    request = SubmissionRequest(
        GeneratorFiles(*files), str(tmp_path / "edits.toml"), "novel", "exact:tiny", size_px=SIZE
    )
    with pytest.raises(UsageError, match="holds a submission already"):
        generate_submission(tiny_dataset, request, tmp_path / "out")
    with pytest.raises(UsageError, match="0 threads"):
        replace(request, threads=0)


def few_frames(dataset: Dataset, protocol: str, count: int) -> Plan:
    """The views of a protocol in its first frames."""
    plan = plan_views(dataset, load_protocol(protocol), "novel")
    numbers = sorted({view.frame_index for view in plan.views})[:count]
    return replace(plan, views=tuple(view for view in plan.views if view.frame_index in numbers))


def test_vehicles_of_a_protocol_are_where_it_moves_them(tiny_dataset: Dataset) -> None:
    """The boxes of a group that are drawn: moved ones at their targets, removed ones nowhere, others as recorded."""
    plan = plan_views(tiny_dataset, load_protocol("editing-accuracy-small"), "novel")
    kinds: set[bool] = set()
    for view in {(one.group, one.frame_index): one for one in plan.views if one.edits}.values():
        frames = tiny_dataset.where(traversal=view.traversal_id).frames()
        frame = next(one for one in frames if one.frame_index == view.frame_index)
        tracks = {name: number for number, name in enumerate(frame.track_ids)}
        ego = Poses(np.array([[0.6, 0.0, 0.0, 0.8]]), np.array([[3.0, -2.0, 1.0]]))
        recorded, found = (boxes_of([PlannedFrame(frame, ego, edits)], tracks) for edits in ((), view.edits))
        edited = {tracks[edit.track_id]: edit for edit in view.edits}
        assert edited.keys() <= set(recorded.track.tolist())
        wanted = {}
        for track, pose in zip(recorded.track.tolist(), recorded.ego_SE3_box):
            if track not in edited:
                wanted[track] = pose
            elif (target := edited[track].world_SE3_target) is not None:
                wanted[track] = np.linalg.inv(ego.matrix()[0]) @ to_pose(target).matrix()[0]
                assert not np.allclose(wanted[track], pose, atol=1e-3) or view.group == "0m"
        assert found.track.tolist() == list(wanted)
        np.testing.assert_allclose(found.ego_SE3_box, np.array([*wanted.values()]).reshape(-1, 4, 4), atol=1e-9)
        kinds |= {edit.world_SE3_target is None for edit in view.edits}
    assert kinds == {True, False}


def test_a_rollout_of_a_submission_has_the_edits_of_its_group(
    tiny_dataset: Dataset, models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, planned = few_frames(tiny_dataset, "editing-accuracy-small", 2), []
    monkeypatch.setattr(planned_views, "roll_out_sequence", lambda _, frames, *__, **___: planned.append(frames) or ())
    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    generator = open_generator(*files)
    list(render_plan(PlannedScenes(tiny_dataset, generator, grey, SIZE, ClipRolloutOptions()), plan, plan.views))
    asked = {(one.group, one.traversal_id, one.frame_index): one.edits for one in plan.views}
    found = [[one.edits for one in frames[5:]] for frames in planned]
    assert found == [
        [asked[key] for key in sorted(asked) if key[:2] == group] for group in sorted({key[:2] for key in asked})
    ]
    assert any(edits for rollout in found for edits in rollout)


def test_a_continued_submission_has_the_images_of_a_whole_one(tiny_dataset: Dataset, models: Path) -> None:
    """Only missing views are given, but their rollout runs from its beginning."""
    plan = few_frames(tiny_dataset, "generation", 3)
    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    options = ClipRolloutOptions(keep_empty_views=False)
    scenes = PlannedScenes(tiny_dataset, open_generator(*files), grey, SIZE, options)

    def made(views: list[RenderView]) -> dict[str, np.ndarray]:
        return {view.path: image for (view,), image in render_plan(scenes, plan, views)}

    last = max(view.frame_index for view in plan.views)
    missing = [view for view in plan.views if view.frame_index == last]
    whole, part = made(list(plan.views)), made(missing)
    assert part.keys() == {view.path for view in missing} < whole.keys()
    assert all(np.array_equal(image, whole[path]) for path, image in part.items())
    # The result of a rollout, not of its last frame alone.
    alone = replace(plan, views=tuple(missing))
    other = {view.path: image for (view,), image in render_plan(scenes, alone, missing)}
    assert any(not np.array_equal(image, other[path]) for path, image in part.items())


def test_views_of_a_submission_are_blended_in_their_own_raster(tiny_dataset: Dataset, models: Path) -> None:
    """Away from boxes they are the background; elsewhere they lie between it and the generated image."""
    plan = few_frames(tiny_dataset, "generation", 2)
    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    generator = open_generator(*files)
    plain, blended = (
        {
            view.path: (view, image.astype(int))
            for (view,), image in render_plan(
                PlannedScenes(tiny_dataset, generator, grey, SIZE, ClipRolloutOptions(blend_px=width)), plan, plan.views
            )
        }
        for width in (None, 0)
    )
    kept = used = 0
    for path, (view, image) in blended.items():
        frames = tiny_dataset.where(traversal=view.traversal_id).frames()
        boxes = next(one for one in frames if one.frame_index == view.frame_index).boxes("world")
        seen = project_boxes(view.lens, view.pose.inverse() @ boxes.pose, boxes.size_m)
        # One pixel of the generator: hulls are drawn in its raster.
        margin = view.width_px / SIZE[1] + 2.0
        near = np.zeros(image.shape[:2], bool)
        for left, top, right, bottom in seen.bounds_px[seen.visible]:
            rows, columns = (max(int(one - margin), 0) for one in (top, left))
            near[rows : int(bottom + margin) + 1, columns : int(right + margin) + 1] = True
        assert (image[~near] == 90).all()
        low, high = (extreme(plain[path][1], 90) for extreme in (np.minimum, np.maximum))
        assert (image >= low).all() and (image <= high).all()
        used, kept = used + int((image == plain[path][1]).all(axis=2)[near].sum()), kept + int((~near).sum())
    assert used > 100 and kept > 100


LAYER = "refined@1"
TURN = Poses.exp(np.array([[0.0, 0.05, 0.02, 0.0, 0.0, 0.1]]))


@pytest.fixture
def refined(tiny_dataset: Dataset, tmp_path: Path) -> Dataset:
    """The dataset with other calibrations of its held-out traversal: turned by 6 degrees, moved by 5 cm, and zoomed."""
    shutil.copytree(tiny_dataset.root, tmp_path / "dataset", copy_function=os.link)
    layout = Layout(tmp_path / "dataset")
    (held_out,) = tiny_dataset.where(split="novel", role="held_out").traversals()
    rows = []
    for used in tiny_dataset.where(traversal=held_out).frames()[0].calibrations:
        pose = {name: float(value[0]) for name, value in (used.ego_SE3_camera @ TURN).to_columns().items()}
        lens = {"fx_px": 1.01 * used.model.fx_px, "fy_px": 1.01 * used.model.fy_px}
        rows.append({**used.row, **pose, **lens, "stage": "refined"})
    LayerWriter(layout, held_out, "calibrations", "refined", "1").finish(CALIBRATIONS, rows, {})
    build_index(layout.root)
    return mirror.open(layout.root)


def test_backgrounds_are_seen_from_the_calibrations_of_the_models_training(
    refined: Dataset, models: Path, tmp_path: Path
) -> None:
    """As `mirror render` has it: at the layer's mountings and through its lenses, in the raster of the protocol."""
    whole = plan_views(refined, load_protocol("generation"), "novel")
    numbers = sorted({view.frame_index for view in whole.views})[::20]
    plan = replace(whole, views=tuple(view for view in whole.views if view.frame_index in numbers))
    files = [models / part / "model.safetensors" for part in ("generator", "autoencoder")]
    generator, options = open_generator(*files), ClipRolloutOptions()
    asked: dict[str, dict[str, RenderView]] = {"recorded": {}, LAYER: {}}
    for layer, views in asked.items():

        def grey(view: RenderView, views: dict[str, RenderView] = views) -> np.ndarray:
            views[view.path] = view
            return np.full((view.height_px, view.width_px, 3), 90, np.uint8)

        scenes = PlannedScenes(refined, generator, grey, SIZE, options, layer)
        made = list(render_plan(scenes, plan, plan.views))
        assert all(image.shape == (view.height_px, view.width_px, 3) for (view,), image in made)
    # Another camera shows other boxes: not the same views keep their background.
    both = asked["recorded"].keys() & asked[LAYER].keys()
    assert {path.split("/")[0] for path in both} == {"frames", "renders"}
    for path in sorted(both):
        before, view = asked["recorded"][path], asked[LAYER][path]
        step = before.pose.inverse() @ view.pose
        np.testing.assert_allclose(step.matrix(), TURN.matrix(), atol=1e-9)
        assert (view.width_px, view.height_px) == (before.width_px, before.height_px)
        # The pinhole that is nearest to a zoomed fisheye is zoomed a little more at its border.
        assert 1.005 < view.fx_px / before.fx_px < 1.03
    # Boxes are seen from there too.
    recorded = rig(refined, plan.views[0].traversal_id)
    frames = refined.with_layers(calibrations=LAYER).where(traversal=plan.views[0].traversal_id).frames()
    moved = recorded.at_calibrations(frames)
    np.testing.assert_allclose(
        (recorded.ego_SE3_camera.inverse() @ moved.ego_SE3_camera).matrix(),
        np.tile(TURN.matrix(), (2, 1, 1)),
        atol=1e-9,
    )
    zoom = moved.intrinsics[:, 0, 0] / recorded.intrinsics[:, 0, 0]
    assert (zoom > 1.005).all() and (zoom < 1.03).all()


def test_a_scene_is_generated_with_the_calibrations_of_its_background(
    refined: Dataset, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = Reconstruction(method="a", scene="b", split="novel", trained={}, calibrations=LAYER)
    write_json(tmp_path / "model" / DOCUMENT, document)
    assert calibrations_of(str(tmp_path / "model")) == LAYER
    assert calibrations_of("exact:tiny") == calibrations_of("files:there") == "recorded"
    monkeypatch.setattr(run_module, "calibrations_of", lambda text: LAYER)
    held_out = refined.where(split="novel", role="held_out").traversals()[0]
    wanted = request(models, refined, held_out, frames=1, edits=())
    assert generate_scene(refined, wanted, tmp_path / "out").inputs["calibrations"] == LAYER
