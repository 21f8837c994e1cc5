"""Training a block: losses, rates, and the growing and pruning of its anchors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from hybridworldsim.scene.losses import colour_loss, depth_loss, normal_loss
from hybridworldsim.scene.refining.anchors import AnchorRefiner
from hybridworldsim.scene.refining.code_gaussians import CodeRefiner
from hybridworldsim.scene.refining.pace import due
from hybridworldsim.scene.refining.pull import pulls
from hybridworldsim.scene.settings import Settings
from hybridworldsim.scene.street import Drawn, Street
from hybridworldsim.training.learner import Rendering, StepReport
from hybridworldsim.training.picture import TrainingPicture
from hybridworldsim.training.state import dumped, load
from hybridworldsim.training.viewpoint import Viewpoint

_BETAS = (0.9, 0.99)
"""A hundred steps of memory, not Adam's thousand: a picture in ten shows a Gaussian, and few of them the same side."""
_SENSORS = 0.1
"""What tells a camera from the others of its traversal learns at this share of the traversal's rate."""


class StreetLearner:
    """A street that learns; a `hybridworldsim.training.learner.Learner`.

    Args:
        street: the model, changed in place.
        settings: how.
    """

    def __init__(self, street: Street, settings: Settings) -> None:
        self.street, self.settings = street, settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        groups = [
            {"params": parameters, "rate": rate, "factor": factor}
            for (rate, factor), parameters in _by_rate(street, settings.sky_radius).items()
        ]
        self._adam = torch.optim.Adam(groups, lr=1e-3, betas=_BETAS, eps=1e-15, fused=True)
        refinement = settings.refinement
        self._anchors = AnchorRefiner(street.background, refinement)
        self._ground = CodeRefiner(street.ground, refinement, refinement.most_ground)
        self._sky = CodeRefiner(street.sky, refinement, refinement.most_sky)
        self._steps, self._refined, self._last = 0, 0, 0

    @property
    def model(self) -> Street:
        """See `Learner`."""
        return self.street

    def step(self, picture: TrainingPicture, progress: float) -> StepReport:
        """Learn from one picture; see `Learner`."""
        settings, street = self.settings, self.street
        for group in self._adam.param_groups:
            group["lr"] = getattr(settings.rates, group["rate"]).at(progress) * group["factor"]
        latent = street.appearance(picture.viewpoint.source)
        growing = self._refined < settings.refinement.times
        drawn = street(picture.viewpoint, latent, pulls=growing)
        losses = self._losses(drawn, picture)
        weights = {
            "rgb": 1.0,
            "depth": settings.depth_weight,
            "normal": settings.normal_weight * settings.normal_every,
        }
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum()
        self._adam.zero_grad(set_to_none=True)
        total.backward()
        self._adam.step()
        self._steps += 1
        if growing:
            self._refine(drawn, picture.viewpoint, progress)
        return StepReport(
            {name: float(loss.detach()) for name, loss in losses.items()}, sum(part.held for part in drawn.parts)
        )

    @torch.no_grad()
    def render(self, viewpoint: Viewpoint) -> Rendering:
        """See `Learner`."""
        drawn = self.street(viewpoint, self.street.appearance(viewpoint.source))
        counts = {
            "held": sum(part.held for part in drawn.parts),
            "decoded": sum(part.decoded for part in drawn.parts),
            "drawn": sum(len(part) for part in drawn.parts),
        }
        return Rendering(drawn.rgb, drawn.alpha, drawn.depth_m, counts)

    def _losses(self, drawn: Drawn, picture: TrainingPicture) -> dict[str, Tensor]:
        settings = self.settings
        losses = {"rgb": colour_loss(drawn.rgb, picture.rgb, picture.scored)}
        if picture.depth_m is not None and settings.depth_weight:
            known = (picture.depth_m > 0.0) & picture.scored & (drawn.alpha.detach() > 0.5)
            losses["depth"] = depth_loss(drawn.depth_m, picture.depth_m, known)
            if settings.normal_weight and self._steps % settings.normal_every == 0:
                losses["normal"] = normal_loss(drawn.depth_m, picture.depth_m, known, picture.viewpoint.K)
        return losses

    def _refine(self, drawn: Drawn, viewpoint: Viewpoint, progress: float) -> None:
        """Keep what the picture tells, and act on it when it is time."""
        refinement = self.settings.refinement
        (rows, pull), *others = pulls(drawn, viewpoint)
        self._anchors.note(drawn.parts[0], rows, pull, viewpoint)
        for refiner, part, (rows, pull) in zip((self._ground, self._sky), drawn.parts[1:], others):
            refiner.note(part, rows, pull)
        if due(refinement, progress) > self._refined and self._steps >= self._last + refinement.least_steps:
            self._refined, self._last = due(refinement, progress), self._steps
            self._anchors.refine(self._refined, self._adam, self._generator)
            self._ground.refine(self._refined, self._adam)
            self._sky.refine(self._refined, self._adam)

    def state(self) -> dict[str, Tensor]:
        """See `Learner`."""
        kept = {
            f"{name}.{key}": table
            for name, refiner in self._refiners().items()
            for key, table in refiner.state().items()
        }
        counters = torch.tensor([self._steps, self._refined, self._last])
        return {
            **dumped(self.street, self._adam), **kept, "generator": self._generator.get_state(), "counters": counters
        }  # fmt: skip

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """See `Learner`."""
        load(self.street, state, self._adam)
        for name, refiner in self._refiners().items():
            own = f"{name}."
            refiner.restore({key.removeprefix(own): table for key, table in state.items() if key.startswith(own)})
        self._generator.set_state(state["generator"])
        self._steps, self._refined, self._last = state["counters"].tolist()

    def _refiners(self) -> dict[str, AnchorRefiner | CodeRefiner]:
        return {"anchors": self._anchors, "ground": self._ground, "sky": self._sky}


def _by_rate(street: Street, sky_radius: float) -> dict[tuple[str, float], list[nn.Parameter]]:
    """What learns at the same share of the same rate together: each group costs a step of its own."""
    groups: dict[tuple[str, float], list[nn.Parameter]] = defaultdict(list)
    for node, factor in ((street.ground, 1.0), (street.sky, sky_radius)):
        groups["means", factor].append(node.means)
        for name in ("quats", "log_scales", "logits", "codes"):
            groups[name, 1.0].append(getattr(node, name))
        groups["networks", 1.0] += node.colour.parameters()
    background = street.background
    for name in ("offsets", "codes", "log_scales"):
        groups[name, 1.0].append(getattr(background, name))
    groups["networks", 1.0] += [*background.geometry.parameters(), *background.colour.parameters()]
    groups["latents", 1.0].append(street.appearance.drives)
    groups["latents", _SENSORS].append(street.appearance.sensors)
    return groups
