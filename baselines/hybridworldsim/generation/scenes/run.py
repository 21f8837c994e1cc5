"""Generates a scene into a folder: frames, a video, and a document written last; an interrupted run continues."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch

from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.devices import repeating_exactly, require_counts
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
from hybridworldsim.generation.scenes.backgrounds import calibrations_of, open_background
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.plan import DEFAULT_HZ, plan_scene
from hybridworldsim.generation.scenes.rates import rate_note
from hybridworldsim.generation.scenes.rig import SceneRig, rig_of
from hybridworldsim.generation.scenes.rollout import SequenceState, roll_out_sequence
from hybridworldsim.generation.scenes.scene_clip import SceneConditions, boxes_of, require_valid_boxes
from hybridworldsim.generation.scenes.scene_edits import apply_edits, parse_edit, require_shown
from hybridworldsim.generation.scenes.scene_map import SceneMap, open_scene_map
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.images.decoding import decode_rgb
from mirror.errors import DatasetError, UsageError
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Pixels
from mirror.protocols.png import encode_png
from mirror.schema.documents import Document
from mirror.schema.files import write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.render_folder import finish_render_folder, start_render_folder

DOCUMENT: Final = "generated.json"
VIDEO: Final = "video.mp4"
PIXELS: Final = Pixels(space="undistorted", max_width_px=8192)
"""Undistortion of lenses: to 70 degrees off the axis at most, as the protocols of generation have it."""
_STATE: Final = "state.safetensors"
_COUNTS: Final = ("generated_views", "kept_views")


class GeneratedDocument(Document):
    """``generated.json``: the content and the source of a folder of generated frames.

    Attributes:
        format: always ``mirror-generated``.
        version: version of this document.
        scene: the scene.
        traversal: the traversal that gives boxes, cameras and seeds.
        cameras: names, in the order of the video.
        rate_hz: frames per second.
        frames: number of generated frames; seeds are not among them.
        generated_views: views that the network generated.
        kept_views: views without a road user, which kept their background.
        trained_rates_hz: lowest and highest rate of the generator's training; None: its file states none.
        rate_note: see `rate_note`; empty where the rate is that of the training.
        seconds: time of this call.
        inputs: everything that determines the frames.
    """

    format: Literal["mirror-generated"] = "mirror-generated"
    version: Literal["1"] = "1"
    scene: str
    traversal: str
    cameras: tuple[str, ...]
    rate_hz: float
    frames: int
    generated_views: int
    kept_views: int
    trained_rates_hz: tuple[float, float] | None = None
    rate_note: str = ""
    seconds: float
    inputs: dict[str, Any]


@dataclass(frozen=True)
class SceneRequest:
    """The request to generate road users over a scene.

    Attributes:
        files: what the generator is read from.
        scene: the scene.
        background: see `open_background`.
        traversal: gives boxes, cameras and seeds; None: the first of the scene.
        trajectory: line of the vehicle in the generated frames; None: the recorded one.
        edits: see `parse_edit`.
        appearance: appearance of a static model.
        cameras: names; None: all.
        size_px: height and width of generated images.
        hz: frames per second; see `plan_scene`.
        frames: largest number of generated frames; None: all.
        rollout: how frames are generated.
        threads: number of torch threads; results repeat exactly with the same number.
        device: where the generator runs.
        method_file: ``FILE.py:OBJECT`` of a static model's method; None: it is installed.
    """

    files: GeneratorFiles
    scene: str
    background: str
    traversal: str | None = None
    trajectory: str | None = None
    edits: tuple[str, ...] = ()
    appearance: str = "nearest"
    cameras: tuple[str, ...] | None = None
    size_px: tuple[int, int] = (64, 96)
    hz: float | None = None
    frames: int | None = None
    rollout: ClipRolloutOptions = field(default_factory=ClipRolloutOptions)
    threads: int = 1
    device: str = "cpu"
    method_file: str | None = None

    def __post_init__(self) -> None:
        if self.hz is not None and not (math.isfinite(self.hz) and self.hz > 0.0):
            raise UsageError(f"{self.hz} frames per second", place="--hz", expected="a finite rate above 0")
        if self.frames is not None and self.frames < 1:
            raise UsageError(f"{self.frames} frames", place="--frames", expected="at least 1")
        require_counts(threads=self.threads)


def generate_scene(
    dataset: Dataset, request: SceneRequest, out: Path, progress: ProgressReporter | None = None
) -> GeneratedDocument:
    """Generate the frames of a scene and write them.

    Args:
        dataset: the dataset.
        request: what is generated.
        out: a new or an empty folder, or that of an interrupted call with the same request.
        progress: receives the number of frames and each finished frame.

    Returns:
        ``generated.json``.

    Raises:
        UsageError: the request does not fit the dataset, or the folder holds other files.
        DatasetError: a model, image, background or map is missing, broken or does not fit.
        WeightsUnavailableError: released weights or captions are missing or do not fit.
    """
    begin = time.perf_counter()
    torch.set_num_threads(request.threads)
    progress = progress or NullProgress()
    captions = request.files.read_captions()
    references = request.files.references
    # A model renders where its training had the cameras; boxes and seeds are seen from there too.
    dataset = dataset.with_layers(calibrations=calibrations_of(request.background))
    traversal = request.traversal or dataset.where(scene=request.scene).traversals()[0]
    trained_hz = request.files.trained_rates()
    plan = plan_scene(
        dataset.where(scene=request.scene),
        traversal,
        hz=request.hz,
        trajectory=request.trajectory,
        references=references,
        count=request.frames,
        trained_hz=DEFAULT_HZ if trained_hz is None else trained_hz[1],
    )
    frames = dataset.where(traversal=traversal).frames()
    rig = rig_of(frames, request.cameras, request.size_px, PIXELS)
    note = rate_note([plan.rate_hz], trained_hz)
    if captions is not None:
        captions.require((traversal,), rig.cameras)
    edits = [parse_edit(text, plan.tracks) for text in request.edits]
    require_valid_boxes(dataset, (one.frame for one in plan.frames))
    require_shown(edits, boxes_of(plan.frames[references:], plan.tracks), plan.tracks)
    views = [view for one in plan.frames for view in rig.views(one.frame, one.world_SE3_ego, plan.light, plan.weather)]
    background, identity = open_background(request.background, dataset, request.appearance, views, request.method_file)
    require_output_folder(out, FolderKind.GENERATED)
    # Only now: released weights take minutes to read.
    generator = request.files.open(request.size_px, request.device, request.rollout.sampler.guidance)
    scene_map = open_scene_map(dataset, request.scene, generator, progress)
    inputs = _inputs(dataset, request, traversal, identity, scene_map)
    settings = [f"{name}={value}" for name, value in sorted(inputs.items())]
    start_render_folder(out, settings, last=DOCUMENT, kind=FolderKind.GENERATED)
    state, counts = _read_state(out)

    driven_m = np.concatenate([one.world_SE3_ego.translation for one in plan.frames])

    def edit(clip: Clip, first: int) -> Clip:
        return apply_edits(clip, edits, plan.tracks, plan.frames[first].world_SE3_ego, driven_m)

    scene = SceneConditions(
        rig, background, plan.rate_hz, plan.light, plan.weather, plan.tracks, captions, scene_map.lines
    )
    total = len(plan.frames) - references
    if note:
        progress.message(note)
    progress.start("generating", total)
    progress.advance(0 if state is None else state.frame - references)
    rollout = roll_out_sequence(
        generator, plan.frames, scene, request.rollout, edit=edit if edits else None, state=state
    )
    with repeating_exactly(request.device):
        for frame, reached in rollout:
            for camera, image in zip(rig.cameras, frame.images):
                write_bytes(out / "frames" / camera / f"{frame.frame - references:05d}.png", encode_png(image))
            counts["generated_views"] += int(frame.generated.sum())
            counts["kept_views"] += int((~frame.generated).sum())
            if reached is not None:
                _write_state(out, reached, counts)
            progress.advance(1)
    from mirror.view.video import write_video

    write_video(out / VIDEO, _mosaics(out, rig, total), plan.rate_hz)
    document = GeneratedDocument(
        scene=request.scene,
        traversal=traversal,
        cameras=rig.cameras,
        rate_hz=plan.rate_hz,
        frames=total,
        seconds=time.perf_counter() - begin,
        inputs=inputs,
        generated_views=counts["generated_views"],
        kept_views=counts["kept_views"],
        trained_rates_hz=trained_hz,
        rate_note=note,
    )
    (out / _STATE).unlink(missing_ok=True)
    write_json(out / DOCUMENT, document)
    finish_render_folder(out, FolderKind.GENERATED)
    return document


def _inputs(
    dataset: Dataset, request: SceneRequest, traversal: str, background: str, scene_map: SceneMap
) -> dict[str, Any]:
    return {
        **request.files.hashes(),
        "scene": request.scene,
        "traversal": traversal,
        "boxes": dataset.layers.boxes,
        "calibrations": dataset.layers.calibrations,
        "trajectory": request.trajectory,
        "edits": list(request.edits),
        "background": background,
        "appearance": request.appearance,
        "cameras": None if request.cameras is None else list(request.cameras),
        "size_px": list(request.size_px),
        "hz": request.hz,
        "frames": request.frames,
        "rollout": repr(request.rollout),
        "threads": request.threads,
        "device": request.device,
        **scene_map.inputs,
    }


def _mosaics(out: Path, rig: SceneRig, count: int) -> Iterator[UInt8]:
    """All cameras side by side, frame by frame."""
    for number in range(count):
        files = [out / "frames" / camera / f"{number:05d}.png" for camera in rig.cameras]
        row = [decode_rgb(file.read_bytes(), "png") for file in files]
        lost = [file for file, image in zip(files, row) if image is None]
        if lost:
            raise DatasetError("a generated image is damaged", file=lost[0], remedy="remove it, and run again")
        yield np.ascontiguousarray(np.concatenate([image for image in row if image is not None], axis=1))


def _write_state(out: Path, state: SequenceState, counts: dict[str, int]) -> None:
    from safetensors.torch import save

    numbers = {name: torch.tensor(value) for name, value in {"frame": state.frame, **counts}.items()}
    write_bytes(out / _STATE, save({"latents": state.latents.cpu().contiguous(), **numbers}))


def _read_state(out: Path) -> tuple[SequenceState | None, dict[str, int]]:
    from safetensors import SafetensorError
    from safetensors.torch import load

    path = out / _STATE
    if not path.is_file():
        return None, dict.fromkeys(_COUNTS, 0)
    try:
        found = load(path.read_bytes())
        return (
            SequenceState(int(found["frame"]), found["latents"]),
            {name: int(found[name]) for name in _COUNTS},
        )
    except (SafetensorError, KeyError, ValueError) as error:
        raise DatasetError(
            f"cannot be read ({error})",
            file=path,
            expected="the state of an interrupted run",
            remedy="remove the folder, and generate it again",
        ) from error


def describe(document: GeneratedDocument) -> str:
    """Describe a generated scene in one line."""
    views = document.generated_views + document.kept_views
    return (
        f"{document.frames} frames of {len(document.cameras)} views at {document.rate_hz:.3g} Hz in"
        f" {document.seconds:.1f} s; {document.kept_views} of {views} views have no road user and kept their background"
    )
