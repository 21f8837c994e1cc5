"""A drive with generated road users: a trained model's empty street, and in it what a generator makes of the agents."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import torch

from hybridworldsim.generation.autoencoder.codec import from_levels, to_levels
from hybridworldsim.generation.clips.clip import CATEGORIES, Clip, ClipBoxes
from hybridworldsim.generation.clips.conditions import frame_conditions
from hybridworldsim.generation.clips.map_lines import MapLine, crop_lines, move_lines
from hybridworldsim.generation.clips.road_map import lines_of_map
from hybridworldsim.generation.inference.blending import blend_tensors, hull_shares
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, clip_hulls
from hybridworldsim.generation.inference.rollout import SequenceRollout
from hybridworldsim.generation.layout.images import draw_frame_layout, takes_map
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.rates import rate_note
from hybridworldsim.generation.scenes.rollout import SceneGenerator
from hybridworldsim.generation.scenes.scene_clip import CLASS_OF
from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.protocol import CameraView, Renderer, ego_pose, to_arrays
from hybridworldsim.simulator.renderers.reconstructed import ReconstructedRenderer
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Bool, Float32, Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.schema.scenario import Scenario

_NEAR_M: Final = 70.0
_COUNTS: Final = ("generated", "kept", "seeds", "fallback", "without_network")


@dataclass(frozen=True)
class DriveGenerator:
    """The choice of a generator for a drive.

    Attributes:
        files: what it is read from.
        rollout: how frames are generated.
        falls_back: whether views that show an agent of a class that the generator does not know are those of the
            renderer ``reconstructed``; else such a scenario is refused.
    """

    files: GeneratorFiles
    rollout: ClipRolloutOptions = field(default_factory=lambda: ClipRolloutOptions(blend_px=4))
    falls_back: bool = False

    def at_rate(self, scenario: Scenario, hz: float | None = None) -> Scenario:
        """Return a scenario at another rate.

        Args:
            scenario: the scenario.
            hz: steps in a second; None: the highest rate of the generator's training, if its file states one.

        Raises:
            UsageError: the rate is not finite or not above 0, or the scenario has no whole step at it.
            DatasetError: the file is missing, broken, or no generator.
        """
        rates = self.files.trained_rates()
        wanted = hz if hz is not None else scenario.rate_hz if rates is None else rates[1]
        if not 0.0 < wanted <= 1000.0 or round(scenario.duration_s * wanted) < 1:
            raise UsageError(
                f"{wanted:g} Hz", place="--hz", expected=f"a rate with at least one step in {scenario.duration_s:g} s",
                remedy="name another rate with --hz",
            )  # fmt: skip
        return Scenario.model_validate({**scenario.model_dump(), "rate_hz": wanted})

    def describe_rate(self, scenario: Scenario) -> str:
        """Describe the rate of a drive, and whether the generator was trained at it."""
        return rate_note([scenario.rate_hz], self.files.trained_rates()) or f"rate: {scenario.rate_hz:g} Hz"

    def open(self, cameras: Mapping[str, CameraSpec], device: str = "cpu") -> SceneGenerator:
        """Read the generator for the images of some cameras, and move it to a device.

        Raises:
            UsageError: the images differ in size, or the generator does not take it.
            DatasetError: a file is missing, broken or of another kind.
        """
        sizes = {(one.camera.height_px, one.camera.width_px) for one in cameras.values()}
        if len(sizes) != 1:
            listed = ", ".join(f"{width} x {height} px" for height, width in sorted(sizes))
            raise UsageError(
                f"images of {listed or 'no camera'}", place="--width", expected="one size for all cameras",
                remedy="name --width and --height",
            )  # fmt: skip
        return self.files.open(sizes.pop(), device)


class GeneratedRenderer(Renderer):
    """Renders the empty street of a trained model with generated road users.

    All cameras are generated at one instant, from the frames that this drive has shown. The first T frames are those of
    the renderer ``reconstructed``, so that no seed shows a vehicle that does not exist. A view without a road user is
    the empty street; a frame in which no view shows one runs no network. A step that does not follow the last one
    begins again with such frames; a step that is asked for again is shown again.

    Args:
        generator: network and autoencoder.
        choice: see `DriveGenerator`.
        base: renders the empty street, and the frames that are not generated.
        street: the street.
        start: the state at the start.
        cameras: the cameras, by name; pinholes of one size.
        rate_hz: steps in a second.
        seed: seed of the noise.

    Attributes:
        counts: views that were generated, that kept the empty street, that seeded the drive, and that the renderer
            ``reconstructed`` showed in their place; and frames that ran no network.

    Raises:
        UsageError: an agent is of a class that the generator does not know, and no fallback is chosen.
    """

    name = "generated"

    def __init__(
        self,
        generator: SceneGenerator,
        choice: DriveGenerator,
        base: ReconstructedRenderer,
        street: Street,
        start: Snapshot,
        cameras: Mapping[str, CameraSpec],
        rate_hz: float,
        seed: int = 0,
    ) -> None:
        super().__init__(street, cameras)
        self._generator, self._choice, self._base = generator, choice, base
        self._rate_hz, self._seed = rate_hz, seed
        self._names = tuple(cameras)
        self._intrinsics = np.stack([one.camera.intrinsic_matrix() for one in cameras.values()])
        self._mounts = np.concatenate([one.ego_SE3_camera.matrix() for one in cameras.values()])
        self._device = next(generator.network.parameters()).device
        self._start = ego_pose(street, start)
        self._lines = self._map_lines()
        self.counts = dict.fromkeys(_COUNTS, 0)
        self._step: int | None = None
        self._shown: dict[str, torch.Tensor] = {}
        self._seeds: list[tuple[torch.Tensor, Conditions]] = []
        self._rollout: SequenceRollout | None = None
        unknown = sorted({agent.category for agent in start.agents if agent.category not in CLASS_OF})
        if unknown and not choice.falls_back:
            raise UsageError(
                f"agents of the class {', '.join(unknown)}, which the generator does not know",
                place="--fallback", expected=f"agents of {', '.join(CLASS_OF)}",
                remedy="--fallback reconstructed shows views with such agents as the renderer reconstructed does",
            )  # fmt: skip

    def view_counts(self) -> dict[str, int]:
        """Return a copy of the counts."""
        return dict(self.counts)

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        return to_arrays(self._draw_tensors(snapshot, views))

    def _draw_tensors(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, torch.Tensor]:
        """Draw images on the generator's device, where they stay from the street's renderer to the encoder and on."""
        names = [view.name for view in views]
        if sorted(names) != sorted(self._names):
            raise UsageError(
                f"views {', '.join(names)}", expected=f"all cameras of the drive at once: {', '.join(self._names)}"
            )
        if snapshot.step != self._step:
            if self._step is None or snapshot.step != self._step + 1:
                self._seeds, self._rollout = [], None
            # the network knows the scene at one instant
            by_name = {view.name: replace(view, shutter=None) for view in views}
            images = self._next_frame(snapshot, [by_name[name] for name in self._names])
            self._shown = dict(zip(self._names, images))
            self._step = snapshot.step
        return {name: self._shown[name].clone() for name in names}

    def _next_frame(self, snapshot: Snapshot, views: Sequence[CameraView]) -> torch.Tensor:
        """The images (V, H, W, 3), uint8, of the step after the last one."""
        background = self._stack(self._base.draw_empty(snapshot, views), self._names)
        clip = self._clip(snapshot, tuple(background.shape))
        layout = draw_frame_layout(clip, 0, self._generator.style, self._generator.network.config)
        conditions = frame_conditions(
            clip, 0, self._generator.network.config, layout, ring=self._generator.ring, background=background
        ).to(self._device)
        if self._rollout is None:
            images = self._stack(self._base.render_view_tensors(snapshot, views), self._names)
            self.counts["seeds"] += len(images)
            self._seeds.append((self._encode(images), conditions))
            if len(self._seeds) == self._generator.references:
                latents, of_seeds = zip(*self._seeds)
                self._rollout = SequenceRollout(
                    self._generator.network, torch.cat(latents, dim=1), of_seeds, self._choice.rollout.sampler,
                    seed=self._seed, first=snapshot.step + 1, dropped_layout=self._generator.style.dropped,
                )  # fmt: skip
            return images
        return self._generate(self._rollout, snapshot, views, clip, background, conditions)

    def _generate(
        self,
        rollout: SequenceRollout,
        snapshot: Snapshot,
        views: Sequence[CameraView],
        clip: Clip,
        background: torch.Tensor,
        conditions: Conditions,
    ) -> torch.Tensor:
        hulls = clip_hulls(clip, 0)
        unknown = self._shows_unknown(snapshot, clip)
        generated: Bool = hulls.any(axis=(1, 2)) & ~unknown
        images = background.clone()
        if unknown.any():
            fallback = [view for view, is_unknown in zip(views, unknown) if is_unknown]
            images[self._move(unknown)] = self._stack(
                self._base.render_view_tensors(snapshot, fallback), [view.name for view in fallback]
            )
        kept = None if generated.all() else self._encode(images)
        latents = rollout.step(conditions, active=np.flatnonzero(generated).tolist(), kept=kept)
        if generated.any():
            chosen = self._move(generated)
            with torch.no_grad():
                found = to_levels(self._generator.codec.decode(latents[0, 0, chosen]))
            blend_px = self._choice.rollout.blend_px
            if blend_px is not None:
                shares = self._move(hull_shares(hulls[generated], blend_px))
                found = blend_tensors(found, background[chosen], shares)
            images[chosen] = found
        self.counts["generated"] += int(generated.sum())
        self.counts["fallback"] += int(unknown.sum())
        self.counts["kept"] += int((~generated & ~unknown).sum())
        self.counts["without_network"] += int(not generated.any())
        return images

    def _clip(self, snapshot: Snapshot, shape: tuple[int, ...]) -> Clip:
        """The present instant as a clip of one frame, with images (V, H, W, 3) that nobody reads."""
        unread: UInt8 = np.broadcast_to(np.uint8(0), (1, *shape))
        ego = ego_pose(self._street, snapshot)
        rows = self._near_rows(snapshot)
        known = [row for row in rows if snapshot.agents[row].category in CLASS_OF]
        categories = [CATEGORIES.index(CLASS_OF[snapshot.agents[row].category]) for row in known]
        lines = self._lines
        if lines is not None:
            lines = move_lines(crop_lines(lines, ego.translation), self._start.inverse().matrix()[0])
        return Clip(
            f"step {snapshot.step}",
            self._street.scene_id,
            self._rate_hz,
            self._names,
            unread,
            unread,
            np.ones((1, len(self._names)), np.bool_),
            self._intrinsics,
            self._mounts,
            (self._start.inverse() @ ego).matrix(),
            self._boxes(snapshot, ego, known, categories),
            lines=lines,
        )

    def _boxes(self, snapshot: Snapshot, ego: Poses, rows: Sequence[int], categories: Sequence[int]) -> ClipBoxes:
        states, chosen = snapshot.states, np.array(rows, np.int64)
        sizes = np.array([snapshot.agents[row].size_m for row in rows], np.float64).reshape(-1, 3)
        x, y, half = states.x_m[chosen], states.y_m[chosen], 0.5 * states.yaw_rad[chosen]
        z = np.asarray(self._street.ground.height_m(x, y)) + 0.5 * sizes[:, 2]
        zero = np.zeros(len(chosen))
        poses: Float64 = np.zeros((0, 4, 4))
        if len(chosen):
            turned = np.column_stack([np.cos(half), zero, zero, np.sin(half)])
            turned *= np.where(turned[:, :1] < 0.0, -1.0, 1.0)
            poses = (ego.inverse() @ Poses(turned, np.column_stack([x, y, z]))).matrix()
        return ClipBoxes(np.zeros(len(chosen), np.int64), chosen, np.array(categories, np.int64), poses, sizes)

    def _near_rows(self, snapshot: Snapshot) -> list[int]:
        states, ego = snapshot.states, snapshot.ego
        away = np.hypot(states.x_m - ego.x_m, states.y_m - ego.y_m)
        return np.flatnonzero(states.present & (away < _NEAR_M)).tolist()

    def _shows_unknown(self, snapshot: Snapshot, clip: Clip) -> Bool:
        """Mark the views (V,) that show an agent of a class that the generator does not know."""
        rows = [row for row in self._near_rows(snapshot) if snapshot.agents[row].category not in CLASS_OF]
        if not rows:
            return np.zeros(len(self._names), np.bool_)
        boxes = self._boxes(snapshot, ego_pose(self._street, snapshot), rows, [0] * len(rows))
        return np.asarray(clip_hulls(replace(clip, boxes=boxes), 0).any(axis=(1, 2)))

    def _map_lines(self) -> tuple[MapLine, ...] | None:
        if not takes_map(self._generator.network.config, self._generator.style):
            return None
        return lines_of_map(self._street.road_map, self._start.translation)

    @torch.no_grad()
    def _encode(self, images: torch.Tensor) -> torch.Tensor:
        """Latents (1, 1, V, C, h, w) of images (V, H, W, 3)."""
        return self._generator.codec.encode(from_levels(images))[None, None]

    def _stack(self, images: Mapping[str, torch.Tensor], names: Iterable[str]) -> torch.Tensor:
        return torch.stack([images[name] for name in names]).to(self._device)

    def _move(self, array: Bool | Float32) -> torch.Tensor:
        return torch.from_numpy(array).to(self._device)
