"""Submissions of trained models: the views that a protocol requests of their scenes, rendered and written."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.devices import CPU, hardware_name
from mirror.errors import UsageError
from mirror.evaluation.submission.manifest import LEAST_COSTS, Appearance, Runtime, SubmittedMethod
from mirror.evaluation.submission.writing import Render, write_submission
from mirror.methods.appearance import AppearancePolicy, require_known_appearance
from mirror.methods.model import ModelFolder
from mirror.methods.model_document import DOCUMENT, Reconstruction, require_held_out_images, require_matching_split
from mirror.methods.registry import read_licence
from mirror.progress import ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.recalibration import recalibrate_views
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True, eq=False)
class ModelSubmission:
    """A submission of trained models that is not rendered yet.

    Attributes:
        dataset: the dataset.
        models: a model of each scene, by scene, all by one method.
        plan: the views that the protocol requests.
        placed: these views with the lenses and mountings that are rendered, by path.
        layers: the layer of calibrations that placed them, by scene.
        appearance: appearance policy for views that were not trained on.
        device: where the models render, see `ModelFolder.choose_device`.
    """

    dataset: Dataset
    models: Mapping[str, ModelFolder]
    plan: Plan
    placed: Mapping[str, RenderView]
    layers: Mapping[str, str]
    appearance: AppearancePolicy
    device: str = CPU

    @property
    def method(self) -> str:
        """Return the name of the method in the documents of the models."""
        return next(iter(self.models.values())).name

    def write(self, out: Path, progress: ProgressReporter) -> int:
        """Render the views and write the submission; an interrupted call is continued.

        Args:
            out: a new or an empty folder, or that of the interrupted call.
            progress: receives the number of views and each finished view.

        Returns:
            The number of views.

        Raises:
            UsageError: the folder holds other files, or the method does not support the appearance policy.
            DatasetError: the folder cannot be written, or a model is not complete.
        """
        documents = [model.document for model in self.models.values()]
        about = SubmittedMethod(
            name=self.method,
            licence=read_licence(self.method),
            trained_on=describe_training(documents, self.layers),
        )
        return write_submission(
            self.dataset, self.plan, self._render, about, describe_appearance(self.appearance), out, progress,
            sum_costs(documents, self.device), of=hash_models(self.models.values()),
        )  # fmt: skip

    def _render(self, _: Dataset, requested: Plan) -> Iterator[Render]:
        for scene, model in self.models.items():
            missing = [view for view in requested.views if view.scene_id == scene]
            if missing:
                render = model.open(self.appearance, device=self.device)
                yield from (([view], render(self.placed[view.path])) for view in missing)


def plan_model_submission(
    dataset: Dataset,
    models: Mapping[str, ModelFolder],
    protocol: Protocol,
    split: str,
    *,
    policy: str = "nearest",
    calibrations: str | None = None,
    device: str = CPU,
) -> ModelSubmission:
    """Plan the submission of trained models; nothing is rendered.

    Args:
        dataset: the dataset that the models were trained on.
        models: a model of each scene of the split, by scene; see `mirror.methods.model.read_models`.
        protocol: the protocol.
        split: name of the split.
        policy: appearance of views that were not trained on; see `AppearancePolicy`.
        calibrations: layer of calibrations that places the cameras; None: that of each model's training.
        device: where the models render, see `ModelFolder.choose_device`.

    Raises:
        UsageError: a model does not fit the split or was trained on images that the protocol scores, a scene of the
            split has no model, the protocol lets no appearance be fitted, or the policy names no trained traversal.
        DatasetError: the split or the layer does not exist.
    """
    for model in models.values():
        require_matching_split(dataset, split, model.document)
        require_held_out_images(protocol, model.document)
    trained = {traversal for model in models.values() for traversal in model.document.trained}
    require_known_appearance(policy, dataset, trained)
    plan = plan_views(dataset, protocol, split)
    without_model = sorted({view.scene_id for view in plan.views} - set(models))
    if without_model:
        raise UsageError(
            f"split {split} also has views of {', '.join(without_model)}", expected="a model of each of its scenes",
            remedy="reconstruct them, and name all models; or make a split of fewer scenes",
        )  # fmt: skip
    if policy == "fit" and protocol.fitted_part is None:
        raise UsageError(
            f"protocol {protocol.name} lets no appearance be fitted", place="--appearance fit",
            expected="another policy, or a protocol with a fitted part, such as static-reconstruction",
        )  # fmt: skip
    layers = {scene: calibrations or model.document.calibrations for scene, model in models.items()}
    placed = {
        view.path: view
        for scene, layer in layers.items()
        for view in recalibrate_views(dataset, [view for view in plan.views if view.scene_id == scene], layer)
    }
    views = tuple(placed[view.path] for view in plan.views)
    appearance = AppearancePolicy(policy, views, truth=(dataset, replace(plan, views=views)))
    return ModelSubmission(dataset, models, plan, placed, layers, appearance, device)


def hash_models(models: Iterable[ModelFolder]) -> str:
    """Return the SHA-256 over the documents of models, which differ between any two trainings."""
    return hashlib.sha256(b"".join((model.folder / DOCUMENT).read_bytes() for model in models)).hexdigest()


def describe_training(documents: Iterable[Reconstruction], rendered: Mapping[str, str]) -> str:
    """Describe the training of a model, trained or distilled, in one line.

    Args:
        documents: documents of the models.
        rendered: layer of calibrations of the renders, by scene.
    """
    documents = list(documents)
    withheld = sum(document.withheld for document in documents)
    splits = ", ".join(sorted({document.split for document in documents}))
    text = f"training traversals of split {splits}, of the scene alone"
    if withheld:
        text += f", without {withheld} of their pictures"
    trained = {document.scene: document.calibrations for document in documents}
    if {*trained.values(), *rendered.values()} != {"recorded"}:
        text += f"; calibrations {', '.join(sorted(set(trained.values())))}"
        if rendered != trained:
            text += f", rendered with {', '.join(sorted(set(rendered.values())))}"
    return text


def sum_costs(documents: Iterable[Reconstruction], rendered_on: str = CPU) -> Runtime:
    """Sum the costs of models for a manifest; state none if the costs of a model are unknown."""
    device = hardware_name(rendered_on)
    costs = [document.done for document in documents]
    known = [cost for cost in costs if cost is not None]
    if len(known) < len(costs):
        return Runtime(device=device)
    stated = {
        "model_bytes": sum(cost.model_bytes for cost in known),
        "driven_m": sum(cost.driven_m for cost in known),
        "training_s": sum(cost.wall_s for cost in known),
    }
    # A method of one file may write nothing, or train within a step of the clock: such a cost is not stated.
    return Runtime.model_validate(
        {"device": device, **{name: value for name, value in stated.items() if value >= LEAST_COSTS[name]}}
    )


def describe_appearance(appearance: AppearancePolicy) -> Appearance:
    """Describe the appearance of images of untrained traversals and cameras, for a manifest."""
    if appearance.policy == "nearest":
        return Appearance(policy="nearest-traversal", description="by the symmetric chamfer distance of driven lines")
    if appearance.policy == "mean":
        return Appearance(policy="mean", description="of the latents of the camera")
    if appearance.policy == "fit":
        return Appearance(policy="fitted", description="the latent alone")
    return Appearance(policy="other", description=f"given: {appearance.policy}")
