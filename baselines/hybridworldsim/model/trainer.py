"""Training a block: losses, rates, and the growing and pruning of its anchors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.model.densification.anchors import AnchorRefiner
from hybridworldsim.model.densification.code_gaussians import CodeRefiner
from hybridworldsim.model.densification.image_gradients import image_gradients
from hybridworldsim.model.densification.schedule import due_refinements
from hybridworldsim.model.lazy_adam import BETA1, BETA2, EPS, LazyAdam
from hybridworldsim.model.losses import colour_loss, depth_loss, structure_loss
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.model.settings import Rate, Settings
from hybridworldsim.model.street import NodeRows, RenderOutput, Street
from hybridworldsim.model.visibility_cache import VisibilityCache
from hybridworldsim.training.state import dump, load
from hybridworldsim.training.trainable_method import Rendering, StepReport
from hybridworldsim.training.training_image import TrainingImage
from hybridworldsim.training.viewpoint import Viewpoint

_SENSORS = 0.1
"""What tells a camera from the others of its traversal learns at this share of the traversal's rate."""


class StreetTrainer:
    """A street that learns; a `hybridworldsim.training.trainable_method.TrainableMethod`.

    Args:
        street: the model, changed in place.
        settings: how.
    """

    def __init__(self, street: Street, settings: Settings) -> None:
        self.street, self.settings = street, settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        self._adam = torch.optim.Adam(_shared(street), lr=1e-3, betas=(BETA1, BETA2), eps=EPS, fused=True)
        self._tables = [LazyAdam(node, node.TABLES) for node in street.nodes]
        refinement = settings.refinement
        anchors, ground, sky = self._tables
        self._anchors = AnchorRefiner(street.background, anchors, refinement)
        self._ground = CodeRefiner(street.ground, ground, refinement, refinement.most_ground)
        self._sky = CodeRefiner(street.sky, sky, refinement, refinement.most_sky)
        self._visibility = VisibilityCache()
        self._steps, self._refined, self._last, self._progress = 0, 0, 0, 0.0

    @property
    def model(self) -> Street:
        """See `TrainableMethod`."""
        return self.street

    def step(self, image: TrainingImage, progress: float) -> StepReport:
        """Learn from one image; see `TrainableMethod`."""
        settings, street, viewpoint = self.settings, self.street, image.viewpoint
        self._progress = progress
        for group in self._adam.param_groups:
            group["lr"] = self._rate(group["rate"], group["factor"])
        latent = street.appearance(viewpoint.source)
        growing = self._refined < settings.refinement.times
        drawn = street(viewpoint, latent, rows=self.visible_rows(viewpoint), track_gradients=growing)
        losses = self._losses(drawn, image)
        weights = {
            "rgb": 1.0,
            "structure": settings.structure_weight,
            "depth": settings.depth_weight,
            "normal": settings.normal_weight * settings.normal_every,
        }
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum()
        self._adam.zero_grad(set_to_none=True)
        for part in drawn.parts:
            part.opacities.retain_grad()
        total.backward()
        self._note(drawn, viewpoint)
        self._adam.step()
        for tables in self._tables:
            tables.end_step()
        self._steps += 1
        if growing:
            self._refine(drawn, viewpoint, progress)
        return StepReport(
            {name: float(loss.detach()) for name, loss in losses.items()},
            sum(part.stored_count for part in drawn.parts),
        )

    @property
    def reads_depth(self) -> bool:
        """See `TrainableMethod`."""
        return bool(self.settings.depth_weight or self.settings.normal_weight)

    @torch.no_grad()
    def render(self, viewpoint: Viewpoint) -> Rendering:
        """See `TrainableMethod`."""
        self.catch_up()
        drawn = self.street(viewpoint, self.street.appearance(viewpoint.source))
        counts = {
            "held": sum(part.stored_count for part in drawn.parts),
            "decoded": sum(part.decoded_count for part in drawn.parts),
            "drawn": sum(len(part) for part in drawn.parts),
        }
        return Rendering(drawn.rgb, drawn.alpha, drawn.depth_m, counts)

    def catch_up(self) -> None:
        """Bring all of the street up to date: rows that were not seen of late are behind."""
        for tables, rates in zip(self._tables, self._rates()):
            tables.catch_up(rates)

    def visible_rows(self, viewpoint: Viewpoint) -> NodeRows:
        """What the viewpoint may see, to be learnt."""
        street = self.street
        seen = [node.visible_ids(viewpoint) for node in street.nodes]
        anchors, ground, sky = self._visibility.select_rows(
            viewpoint, seen, [tables.numbers for tables in self._tables]
        )
        learnt = [
            tables.begin_step(ids, rates)
            for tables, ids, rates in zip(self._tables, (anchors, ground, sky), self._rates())
        ]
        return NodeRows(
            street.background.rows(anchors, learnt[0]),
            street.ground.rows(ground, learnt[1]),
            street.sky.rows(sky, learnt[2]),
        )

    def _note(self, drawn: RenderOutput, viewpoint: Viewpoint) -> None:
        """Keep what the image shows: of what it does not, all gradients are zero."""
        shown = [
            part.rows[:0] if part.opacities.grad is None else part.rows[part.opacities.grad != 0.0]
            for part in drawn.parts
        ]
        shown[0] = shown[0] // self.street.background.k
        self._visibility.record(viewpoint, shown, [tables.numbers for tables in self._tables])

    def _rate(self, name: str, factor: float = 1.0) -> float:
        rate: Rate = getattr(self.settings.rates, name)
        return rate.at(self._progress) * factor

    def _rates(self) -> Iterator[dict[str, float]]:
        """Of each node the rates of its tables: the sky is farther away than the rest, and moves in longer steps."""
        for tables, far in zip(self._tables, (1.0, 1.0, self.settings.sky_radius)):
            yield {name: self._rate(name, far if name == "means" else 1.0) for name in tables.names}

    def _losses(self, drawn: RenderOutput, image: TrainingImage) -> dict[str, Tensor]:
        settings = self.settings
        losses = {"rgb": colour_loss(drawn.rgb, image.rgb, image.scored)}
        if settings.structure_weight:
            losses["structure"] = structure_loss(drawn.rgb, image.rgb, image.scored)
        if image.depth_m is not None and self.reads_depth:
            known = (image.depth_m > 0.0) & image.scored & (drawn.alpha.detach() > 0.5)
            if settings.depth_weight:
                losses["depth"] = depth_loss(drawn.depth_m, image.depth_m, known)
            if settings.normal_weight and self._steps % settings.normal_every == 0:
                losses["normal"] = normal_loss(drawn.depth_m, image.depth_m, known, image.viewpoint.K)
        return losses

    def _refine(self, drawn: RenderOutput, viewpoint: Viewpoint, progress: float) -> None:
        """Keep what the image tells, and act on it when it is time."""
        refinement = self.settings.refinement
        (rows, pull), *others = image_gradients(drawn, viewpoint)
        self._anchors.accumulate(drawn.parts[0], rows, pull, viewpoint)
        for refiner, part, (rows, pull) in zip((self._ground, self._sky), drawn.parts[1:], others):
            refiner.accumulate(part, rows, pull)
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
            own = f"{name}."
            part.restore({key.removeprefix(own): table for key, table in state.items() if key.startswith(own)})
        self._generator.set_state(state["generator"])
        self._steps, self._refined, self._last = state["counters"].tolist()
        self._progress = float(state["progress"])

    def _parts(self) -> dict[str, AnchorRefiner | CodeRefiner | LazyAdam | VisibilityCache]:
        return {
            "anchors": self._anchors,
            "ground": self._ground,
            "sky": self._sky,
            "sightings": self._visibility,
            **{f"{name}.adam": tables for name, tables in zip(("anchors", "ground", "sky"), self._tables)},
        }


def _shared(street: Street) -> list[dict[str, Any]]:
    """What all that an image shows has in common: networks and appearances."""
    networks = [street.background.geometry, *(node.colour for node in street.nodes)]
    return [
        {"params": [own for network in networks for own in network.parameters()], "rate": "networks", "factor": 1.0},
        {"params": [street.appearance.drives], "rate": "latents", "factor": 1.0},
        {"params": [street.appearance.sensors], "rate": "latents", "factor": _SENSORS},
    ]
