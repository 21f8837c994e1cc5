"""Training of a block: losses, learning rates, and the refinement of its Gaussians."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.light.light_training import LightTraining
from hybridworldsim.model.dense_adam import DenseAdam, TableAdam
from hybridworldsim.model.densification.anchors import AnchorRefiner
from hybridworldsim.model.densification.code_gaussians import CodeRefiner
from hybridworldsim.model.densification.image_gradients import image_gradients
from hybridworldsim.model.densification.schedule import due_refinements
from hybridworldsim.model.lazy_adam import BETA1, BETA2, EPS, LazyAdam
from hybridworldsim.model.losses import colour_loss, depth_loss, structure_loss
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.model.settings import Rate, Settings
from hybridworldsim.model.street import NodeRows, StreetModel, StreetOutput
from hybridworldsim.model.visibility_cache import VisibilityCache
from hybridworldsim.trainable.method import Rendering, StepReport
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Viewpoint
from hybridworldsim.training.run.state import dump, load
from mirror.devices import CPU

_SENSOR_RATE_SHARE = 0.1
"""Learning rate of a sensor's latent, as a share of the learning rate of its traversal's latent."""
_RESPONSE_RATE_SHARE = 0.2
"""Learning rate of the cameras' response, as a share of that of the networks."""


class StreetTrainer:
    """A trainer of a street; a `hybridworldsim.trainable.method.TrainableMethod`.

    Args:
        street: the model, changed in place.
        settings: its settings.
        dense: whether each step updates all rows (`DenseAdam`), or those that it uses (`LazyAdam`); None: all on a GPU,
            where what the step uses would have to be read back.
    """

    def __init__(self, street: StreetModel, settings: Settings, *, dense: bool | None = None) -> None:
        self.street, self.settings = street, settings
        self._device = street.background.means.device
        self._generator = torch.Generator().manual_seed(settings.seed)
        self._adam = torch.optim.Adam(_shared_parameters(street), lr=1e-3, betas=(BETA1, BETA2), eps=EPS, fused=True)
        lazy = dense is not True and (dense is False or self._device.type == "cpu")
        self._tables: list[TableAdam] = [
            LazyAdam(node, node.TABLES) if lazy else DenseAdam(node, node.TABLES) for node in street.nodes
        ]
        refinement = settings.refinement
        anchors, ground, sky = self._tables
        self._anchors = AnchorRefiner(street.background, anchors, refinement)
        self._ground = CodeRefiner(street.ground, ground, refinement, refinement.most_ground)
        self._sky = CodeRefiner(street.sky, sky, refinement, refinement.most_sky)
        self._visibility = VisibilityCache()
        self._light = None if street.light is None else LightTraining(street.light)
        self._steps, self._refined, self._last, self._progress = 0, 0, 0, 0.0

    def to(self, device: str) -> StreetTrainer:
        """Return a trainer of the same untrained street on a device."""
        return self if device == CPU else StreetTrainer(self.street.to(device), self.settings)

    @property
    def model(self) -> StreetModel:
        """See `TrainableMethod`."""
        return self.street

    def step(self, image: TrainingImage, progress: float) -> StepReport:
        """Train on one image; see `TrainableMethod`."""
        image = image.to(self._device)
        settings, street, viewpoint = self.settings, self.street, image.viewpoint
        self._progress = progress
        for group in self._adam.param_groups:
            group["lr"] = self._rate(group["rate"], group["factor"])
        latent = street.appearance(viewpoint.source)
        growing = self._refined < settings.refinement.times
        output = street(viewpoint, latent, rows=self.visible_rows(viewpoint), track_gradients=growing)
        if self._light is not None:
            output = replace(output, rgb=self._light.respond(output.rgb, image, progress))
        losses = self._losses(output, image)
        weights = {
            "rgb": 1.0,
            "structure": settings.structure_weight,
            "depth": settings.depth_weight,
            "normal": settings.normal_weight * settings.normal_every,
        }
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum()
        self._adam.zero_grad(set_to_none=True)
        lazy = isinstance(self._tables[0], LazyAdam)
        for part in output.parts if lazy else ():
            part.opacities.retain_grad()
        total.backward()
        if lazy:
            self._record_visibility(output, viewpoint)
        self._adam.step()
        for tables in self._tables:
            tables.end_step()
        self._steps += 1
        if growing:
            self._refine(output, viewpoint, progress)
        # Read together: each reading waits for the GPU.
        values = torch.stack([loss.detach() for loss in losses.values()]).tolist()
        return StepReport(
            dict(zip(losses, values)),
            sum(part.stored_count for part in output.parts),
        )

    @property
    def reads_depth(self) -> bool:
        """See `TrainableMethod`."""
        return bool(self.settings.depth_weight or self.settings.normal_weight)

    @torch.no_grad()
    def render(self, viewpoint: Viewpoint) -> Rendering:
        """See `TrainableMethod`."""
        self.catch_up()
        output = self.street(viewpoint, self.street.appearance(viewpoint.source))
        counts = {
            "held": sum(part.stored_count for part in output.parts),
            "decoded": sum(part.decoded_count for part in output.parts),
            "drawn": sum(len(part) for part in output.parts),
        }
        return Rendering(output.rgb, output.alpha, output.depth_m, counts)

    def finish(self) -> None:
        """Bring all rows up to date, and store what the training knows of the light: the model is to be written."""
        self.catch_up()
        if self._light is not None:
            self._light.finish()

    def catch_up(self) -> None:
        """Bring all rows up to date; rows that no recent step used have missed updates."""
        for tables, rates in zip(self._tables, self._rates()):
            tables.catch_up(rates)

    def visible_rows(self, viewpoint: Viewpoint) -> NodeRows:
        """Begin a step of the optimisers for the rows that the viewpoint may see."""
        street = self.street
        if dense := [tables for tables in self._tables if isinstance(tables, DenseAdam)]:
            every = [torch.arange(len(node), device=self._device) for node in street.nodes]
            taken = [tables.begin_step(rates) for tables, rates in zip(dense, self._rates())]
            return _rows_of(street, every, taken)
        lazy = [tables for tables in self._tables if isinstance(tables, LazyAdam)]
        visible = [node.visible_ids(viewpoint) for node in street.nodes]
        selected = self._visibility.select_rows(viewpoint, visible, [tables.numbers for tables in lazy])
        gathered = [tables.begin_step(ids, rates) for tables, ids, rates in zip(lazy, selected, self._rates())]
        return _rows_of(street, selected, gathered)

    def _record_visibility(self, output: StreetOutput, viewpoint: Viewpoint) -> None:
        """Record which rows the image shows: those with a gradient of the opacity."""
        shown_rows = [
            part.rows[:0] if part.opacities.grad is None else part.rows[part.opacities.grad != 0.0]
            for part in output.parts
        ]
        shown_rows[0] = shown_rows[0] // self.street.background.k
        self._visibility.record(
            viewpoint, shown_rows, [tables.numbers for tables in self._tables if isinstance(tables, LazyAdam)]
        )

    def _rate(self, name: str, factor: float = 1.0) -> float:
        rate: Rate = getattr(self.settings.rates, name)
        return rate.at(self._progress) * factor

    def _rates(self) -> Iterator[dict[str, float]]:
        """The learning rates of each node's tables; the sky is more distant than the rest and moves in longer steps."""
        for tables, means_factor in zip(self._tables, (1.0, 1.0, self.settings.sky_radius)):
            yield {name: self._rate(name, means_factor if name == "means" else 1.0) for name in tables.names}

    def _losses(self, output: StreetOutput, image: TrainingImage) -> dict[str, Tensor]:
        settings = self.settings
        losses = {"rgb": colour_loss(output.rgb, image.rgb, image.scored)}
        if settings.structure_weight:
            losses["structure"] = structure_loss(output.rgb, image.rgb, image.scored)
        if image.depth_m is not None and self.reads_depth:
            known = (image.depth_m > 0.0) & image.scored & (output.alpha.detach() > 0.5)
            if settings.depth_weight:
                losses["depth"] = depth_loss(output.depth_m, image.depth_m, known)
            if settings.normal_weight and self._steps % settings.normal_every == 0:
                losses["normal"] = normal_loss(output.depth_m, image.depth_m, known, image.viewpoint.K)
        return losses

    def _refine(self, output: StreetOutput, viewpoint: Viewpoint, progress: float) -> None:
        """Collect the statistics of the image, and refine when it is due."""
        refinement = self.settings.refinement
        background, *others = image_gradients(output, viewpoint)
        self._anchors.accumulate(output.parts[0], background, viewpoint)
        for refiner, part, gradients in zip((self._ground, self._sky), output.parts[1:], others):
            refiner.accumulate(part, gradients)
        if due_refinements(refinement, progress) > self._refined and self._steps >= self._last + refinement.least_steps:
            self._refined, self._last = due_refinements(refinement, progress), self._steps
            self.catch_up()
            self._anchors.refine(self._refined, self._generator)
            self._ground.refine(self._refined)
            self._sky.refine(self._refined)

    def state(self) -> dict[str, Tensor]:
        """See `TrainableMethod`."""
        kept = {f"{name}.{key}": table for name, part in self._parts().items() for key, table in part.state().items()}
        counters = torch.tensor([self._steps, self._refined, self._last])
        return {
            **dump(self.street, self._adam), **kept, "generator": self._generator.get_state(), "counters": counters,
            "progress": torch.tensor(self._progress, dtype=torch.float64),
        }  # fmt: skip

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """See `TrainableMethod`."""
        load(self.street, state, self._adam)
        for name, part in self._parts().items():
            parameter = f"{name}."
            part.restore(
                {key.removeprefix(parameter): table for key, table in state.items() if key.startswith(parameter)}
            )
        self._generator.set_state(state["generator"])
        self._steps, self._refined, self._last = state["counters"].tolist()
        self._progress = float(state["progress"])

    def _parts(self) -> dict[str, AnchorRefiner | CodeRefiner | TableAdam | VisibilityCache | LightTraining]:
        return {
            **({} if self._light is None else {"light": self._light}),
            "anchors": self._anchors,
            "ground": self._ground,
            "sky": self._sky,
            "sightings": self._visibility,
            **{f"{name}.adam": tables for name, tables in zip(("anchors", "ground", "sky"), self._tables)},
        }


def _rows_of(street: StreetModel, ids: Sequence[Tensor], tables: Sequence[Mapping[str, Tensor]]) -> NodeRows:
    return NodeRows(
        street.background.rows(ids[0], tables[0]),
        street.ground.rows(ids[1], tables[1]),
        street.sky.rows(ids[2], tables[2]),
    )


def _shared_parameters(street: StreetModel) -> list[dict[str, Any]]:
    """Parameters that all images share: networks and latents."""
    networks = [street.background.geometry, *(node.colour for node in street.nodes)]
    return [
        {
            "params": [parameter for network in networks for parameter in network.parameters()],
            "rate": "networks",
            "factor": 1.0,
        },
        {"params": [street.appearance.drives], "rate": "latents", "factor": 1.0},
        {"params": [street.appearance.sensors], "rate": "latents", "factor": _SENSOR_RATE_SHARE},
        *_light_parameters(street),
    ]


def _light_parameters(street: StreetModel) -> list[dict[str, Any]]:
    if street.light is None:
        return []
    response = list(street.light.response.parameters())
    groups = [{"params": response, "rate": "networks", "factor": _RESPONSE_RATE_SHARE}]
    if street.light.headlights is not None:
        groups.append({"params": list(street.light.headlights.parameters()), "rate": "networks", "factor": 1.0})
    return groups
