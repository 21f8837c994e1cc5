"""Training a block: losses, rates, and the growing and pruning of its anchors."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from hybridworldsim.scene.growth import Statistics, grown
from hybridworldsim.scene.losses import colour_loss, depth_loss, normal_loss
from hybridworldsim.scene.rows import replace_rows
from hybridworldsim.scene.settings import Settings
from hybridworldsim.scene.street import Drawn, Street
from hybridworldsim.training.learner import Rendering, StepReport
from hybridworldsim.training.picture import TrainingPicture
from hybridworldsim.training.state import dumped, load
from hybridworldsim.training.viewpoint import Viewpoint

_ANCHOR_TABLES = ["means", "offsets", "codes", "log_scales"]
_PRUNED_SEEN = 10


class StreetLearner:
    """A street that learns; a `hybridworldsim.training.learner.Learner`.

    Args:
        street: the model, changed in place.
        settings: how.
    """

    def __init__(self, street: Street, settings: Settings) -> None:
        self.street, self.settings = street, settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        groups = []
        sky_scale = settings.sky_radius
        for node, scale in ((street.ground, 1.0), (street.sky, sky_scale)):
            for name in ("means", "quats", "log_scales", "logits", "codes"):
                factor = scale if name == "means" else 1.0
                groups.append({"params": [getattr(node, name)], "rate": name, "factor": factor})
            groups.append({"params": list(node.colour.parameters()), "rate": "networks", "factor": 1.0})
        background = street.background
        for name in ("offsets", "codes", "log_scales"):
            groups.append({"params": [getattr(background, name)], "rate": name, "factor": 1.0})
        networks = [*background.geometry.parameters(), *background.colour.parameters()]
        groups.append({"params": networks, "rate": "networks", "factor": 1.0})
        groups.append({"params": [street.appearance.latents], "rate": "latents", "factor": 1.0})
        self._adam = torch.optim.Adam(groups, lr=1e-3, eps=1e-15, fused=True)
        self._statistics = Statistics.empty(len(background), background.k)
        self._steps, self._refined = 0, 0
        self._first_anchors = len(background)

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
        drawn = street(picture.viewpoint, latent)
        losses = self._losses(drawn, picture)
        weights = {
            "rgb": 1.0,
            "depth": settings.depth_weight,
            "normal": settings.normal_weight * settings.normal_every,
            "volume": settings.volume_weight,
        }
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum()
        self._adam.zero_grad(set_to_none=True)
        total.backward()
        self._note(drawn, picture.viewpoint)
        self._adam.step()
        self._steps += 1
        self._refine(progress)
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
        if settings.volume_weight and len(drawn.parts[0]):
            losses["volume"] = drawn.parts[0].scales.prod(1).mean()
        return losses

    def _note(self, drawn: Drawn, viewpoint: Viewpoint) -> None:
        """Keep what refinement will ask about."""
        refinement = self.settings.refinement
        background = drawn.parts[0]
        if self._refined >= refinement.times or not len(background):
            return
        gradient = drawn.meta["means2d"].grad
        if gradient is None:
            return
        ids = drawn.meta["gaussian_ids"]
        own = ids < len(background)
        size = gradient.new_tensor((viewpoint.width_px / 2.0, viewpoint.height_px / 2.0))
        pull = (gradient[own] * size).norm(dim=1)
        rows = background.rows[ids[own]]
        statistics = self._statistics
        statistics.pull.view(-1).index_add_(0, rows, pull)
        statistics.drawn.view(-1).index_add_(0, rows, torch.ones_like(pull))
        anchors = background.rows // self.street.background.k
        statistics.opacity.index_add_(0, anchors, background.opacities.detach())
        seen = background.seen
        statistics.seen[seen] += 1.0

    def _refine(self, progress: float) -> None:
        """Prune and grow, as often as progress is through the next of the refinements."""
        refinement = self.settings.refinement
        share = (progress - refinement.begin) / (refinement.end - refinement.begin)
        if share * refinement.times < self._refined + 1 or self._refined >= refinement.times:
            return
        self._refined = min(int(share * refinement.times), refinement.times)
        background, statistics = self.street.background, self._statistics
        pruned = (statistics.seen >= _PRUNED_SEEN) & (statistics.opacity < refinement.least_opacity * statistics.seen)
        keep = (~pruned).nonzero().squeeze(1)
        wanted = self._first_anchors + (refinement.most - self._first_anchors) * min(1.2 * share, 1.0)
        room = max(int(wanted) - len(keep), 0)
        added = self._candidates(room)
        if pruned.any() or len(added["means"]):
            replace_rows(background, _ANCHOR_TABLES, self._adam, keep, added)
        self._statistics = Statistics.empty(len(background), background.k)

    @torch.no_grad()
    def _candidates(self, room: int) -> dict[str, Tensor]:
        background, statistics, refinement = self.street.background, self._statistics, self.settings.refinement
        mean = statistics.pull / statistics.drawn.clamp_min(1.0)
        mean = torch.where(
            statistics.drawn >= max(2.0, refinement.least_share * float(statistics.seen.max())), mean, 0.0
        )
        rows = mean.view(-1).nonzero().squeeze(1)
        parents = rows // background.k
        points = (
            background.means[parents] + background.offsets.view(-1, 3)[rows] * background.log_scales[parents, :3].exp()
        )
        centres, sizes, chosen = grown(points, mean.view(-1)[rows], background.means, refinement.cells_m, room)
        count = len(centres)
        offsets = 2.0 * torch.rand(count, background.k, 3, generator=self._generator) - 1.0
        return {
            "means": centres,
            "offsets": 0.5 * offsets,
            "codes": background.codes[parents[chosen]],
            "log_scales": sizes.log()[:, None].repeat(1, 6),
        }

    def state(self) -> dict[str, Tensor]:
        """See `Learner`."""
        statistics = {f"statistics.{name}": table for name, table in vars(self._statistics).items()}
        return {
            **dumped(self.street, self._adam),
            **statistics,
            "generator": self._generator.get_state(),
            "counters": torch.tensor([self._steps, self._refined, self._first_anchors]),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """See `Learner`."""
        load(self.street, state, self._adam)
        self._statistics = Statistics(**{name: state[f"statistics.{name}"].clone() for name in vars(self._statistics)})
        self._generator.set_state(state["generator"])
        self._steps, self._refined, self._first_anchors = state["counters"].tolist()
