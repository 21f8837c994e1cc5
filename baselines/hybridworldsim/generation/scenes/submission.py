"""Generated frames as a submission to the protocols of generation: every view of a plan, edits included."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch

from hybridworldsim.generation.devices import repeating_exactly, require_counts
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
from hybridworldsim.generation.scenes.backgrounds import calibrations_of, open_background
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.planned_views import PlannedScenes, render_plan
from hybridworldsim.generation.scenes.rates import plan_rates, rate_note
from hybridworldsim.generation.scenes.scene_clip import require_valid_boxes
from hybridworldsim.generation.scenes.scene_map import open_scene_map
from mirror.dataset.dataset import Dataset
from mirror.evaluation.submission.manifest import Appearance, Runtime, SubmittedMethod
from mirror.evaluation.submission.writing import write_submission
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.recalibration import recalibrate_views
from mirror.schema.folders import FolderKind, require_output_folder


@dataclass(frozen=True)
class SubmissionRequest:
    """The request to generate a submission.

    Attributes:
        files: what the generator is read from.
        protocol: name or file of the protocol that asks for the views.
        split: split that the views are of.
        background: see `open_background`.
        appearance: appearance of a static model.
        size_px: height and width of generated images.
        rollout: how frames are generated.
        threads: number of torch threads; results repeat exactly with the same number.
        device: where the generator runs.
        method_file: ``FILE.py:OBJECT`` of a static model's method; None: it is installed.
    """

    files: GeneratorFiles
    protocol: str
    split: str
    background: str
    appearance: str = "nearest"
    size_px: tuple[int, int] = (64, 96)
    rollout: ClipRolloutOptions = field(default_factory=ClipRolloutOptions)
    threads: int = 1
    device: str = "cpu"
    method_file: str | None = None

    @property
    def method(self) -> SubmittedMethod:
        """The submission's statement of the generator."""
        if self.files.base is None:
            return SubmittedMethod(
                name="hybridworldsim-generation", licence="Apache-2.0", trained_on="clips of other drives"
            )  # fmt: skip
        return SubmittedMethod(
            name=f"hybridworldsim-{self.files.base.name}", trained_on=self.files.base.trained_on, licence="MIT",
            url="https://github.com/SenseTime-FVG/OpenDWM",
        )  # fmt: skip

    def __post_init__(self) -> None:
        require_counts(threads=self.threads)


def generate_submission(
    dataset: Dataset, request: SubmissionRequest, out: Path, progress: ProgressReporter | None = None
) -> int:
    """Generate every view that a protocol asks for, and write the submission.

    Args:
        dataset: the dataset.
        request: what is submitted.
        out: a new or an empty folder, or that of an interrupted call with the same request.
        progress: receives the number of views and each written view.

    Returns:
        The number of views.

    Raises:
        UsageError: the request does not fit the dataset, or the folder holds other files.
        DatasetError: a model, image, background or map is missing, broken or does not fit.
        WeightsUnavailableError: released weights or captions are missing or do not fit.
    """
    torch.set_num_threads(request.threads)
    captions = request.files.read_captions()
    plan = plan_views(dataset, load_protocol(request.protocol), request.split)
    for view in plan.views:
        if captions is not None:
            captions.require((view.traversal_id,), [view.camera])
    calibrations = calibrations_of(request.background)
    views = recalibrate_views(dataset, plan.views, calibrations)
    background, identity = open_background(request.background, dataset, request.appearance, views, request.method_file)
    for traversal in dict.fromkeys(view.traversal_id for view in plan.views):
        wanted = {view.frame_index for view in plan.views if view.traversal_id == traversal}
        frames = dataset.where(traversal=traversal).frames()
        require_valid_boxes(dataset, (frame for frame in frames if frame.frame_index in wanted))
    note = rate_note(plan_rates(dataset, plan), request.files.trained_rates())
    if note and progress is not None:
        progress.message(note)
    require_output_folder(out, FolderKind.SUBMISSION)
    # Only now: released weights take minutes to read.
    generator = request.files.open(request.size_px, request.device, request.rollout.sampler.guidance)
    names = dict.fromkeys(view.scene_id for view in plan.views)
    maps = {scene: open_scene_map(dataset, scene, generator, progress or NullProgress()) for scene in names}
    scenes = PlannedScenes(
        dataset, generator, background, request.size_px, request.rollout, calibrations, captions, maps
    )
    inputs = (
        *(*request.files.hashes().values(), identity),
        *(repr(request.rollout), repr(request.size_px), str(dataset.layers.boxes)),
        *(str(request.threads), request.device),
        *(f"{name} of {scene}: {value}" for scene, one in maps.items() for name, value in one.inputs.items()),
    )
    on_gpu = torch.device(request.device).type == "cuda"
    with repeating_exactly(request.device):
        return write_submission(
            dataset,
            plan,
            lambda _, requested: render_plan(scenes, plan, requested.views),
            request.method,
            Appearance(policy="other", description=f"of the background: {request.appearance}"),
            out,
            progress,
            costs=Runtime(device=torch.cuda.get_device_name(request.device)) if on_gpu else None,
            of="|".join(inputs),
            notes=note,
        )
