"""A reconstructed street: a trained model's images of the empty street, with agents composed into them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.dispatch import runs_kernels
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers import plain_compositing as plain
from hybridworldsim.simulator.renderers.agent_layer import AgentImage, AgentLayer
from hybridworldsim.simulator.renderers.compositing import (
    add_contact_shadows,
    compose,
    free_space,
    hiding_depth,
)
from hybridworldsim.simulator.renderers.protocol import CameraView, Renderer, to_arrays
from hybridworldsim.simulator.renderers.rolling import Band, cut_bands
from hybridworldsim.simulator.street.street import Street, StreetRecording
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import AnyArray, Float32, Float64, Int32, UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.methods.model import ModelFolder, ModelRenderer
from mirror.methods.model_document import Reconstruction, read_reconstruction, require_finished
from mirror.protocols.views.view import RenderView, ViewShutter
from mirror.schema.scenario import Scenario
from mirror.synth import Condition, Instant, instant_of

_NO_POSITION = (0.0, 45.0)
_NEAR_M = 70.0


def require_model_of(path: Path, street: Street) -> tuple[Reconstruction, tuple[str, ...]]:
    """Return the document of a street's model, and the street's traversals in the model's training.

    Raises:
        DatasetError: the folder holds no model that is trained to the end.
        UsageError: the model is of another scene.
    """
    document = read_reconstruction(path)
    trained = tuple(name for name in sorted(document.trained) if name in street.recordings)
    if document.scene != street.scene_id or (street.drive is None and not trained):
        raise UsageError(
            f"the model shows scene {document.scene}", file=path,
            expected=f"a model of {street.scene_id} that was trained on its recordings",
            remedy="name the dataset that the model was trained on, and its scene",
        )  # fmt: skip
    require_finished(document, path)
    return document, trained


@dataclass(frozen=True, eq=False)
class OpenModel:
    """An open model, which rollouts share.

    Attributes:
        path: its folder.
        scene: the scene that it shows.
        trained: ids of the traversals that it was trained on.
        renderer: its renderer, which renders depth.
        device: where it renders, as torch names it.
    """

    path: Path
    scene: str
    trained: tuple[str, ...]
    renderer: ModelRenderer
    device: str = CPU

    @classmethod
    def read(
        cls, path: Path, street: Street, method: str | None = None, *, option: str = "--method ", device: str = CPU
    ) -> OpenModel:
        """Open the model of a street.

        Args:
            path: its folder.
            street: the street.
            method: ``FILE.py:OBJECT`` of the model's method; None: it is installed.
            option: how the user names the method, for messages.
            device: where it renders, see `ModelFolder.choose_device`.

        Raises:
            DatasetError: the folder holds no complete model.
            UsageError: the model is of another scene, or its method cannot be loaded or does not render depth.
        """
        document, trained = require_model_of(path, street)
        renderer = ModelFolder.read(path, method, option=option).open(device=device)
        if not renderer.capabilities.renders_depth:
            raise UsageError(
                f"method {document.method} renders no depth, which places road users in its images", file=path,
                expected="a method whose renderer has a function `render` with depth, such as hybridworldsim",
            )  # fmt: skip
        return cls(path, document.scene, trained or tuple(sorted(document.trained)), renderer, device)


class Seconds:
    """Time that threads spent in each part of rendering, measured by thread clocks."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parts = dict.fromkeys(("street", "agents", "composition"), 0.0)

    def add(self, part: str, begin_s: float) -> float:
        """Add the thread time since an earlier reading to a part of rendering, and return the present reading."""
        now = time.thread_time()
        with self._lock:
            self._parts[part] += now - begin_s
        return now

    def parts(self) -> dict[str, float]:
        """Return the processor time of each part of rendering, in seconds."""
        return dict(self._parts)

    def clear(self) -> None:
        """Begin again."""
        self._parts = dict.fromkeys(self._parts, 0.0)


class ReconstructedRenderer(Renderer):
    """A renderer of a trained model with agents; cameras are rendered in parallel on torch's number of threads.

    Agents are drawn on the CPU and put into the images on the model's device.

    Args:
        model: the model.
        street: its street.
        scenario: its light and weather choose the appearance: that of a trained traversal with both, or with the light.
        start: the state at the start.
        cameras: the cameras, by name; pinholes.
        appearance: the trained traversal whose appearance the images have; None: it is chosen.
        seed: seed of the images' noise, of a model that knows the noise of its cameras.
    """

    name = "reconstructed"

    def __init__(
        self,
        model: OpenModel,
        street: Street,
        scenario: Scenario,
        start: Snapshot,
        cameras: Mapping[str, CameraSpec],
        appearance: str | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(street, cameras)
        self.seconds = Seconds()
        self._model, self._seed = model, seed
        self._appearance = appearance or choose_appearance(model, street, scenario)
        condition = _condition(street, self._appearance, scenario)
        self.layer = AgentLayer(street, condition, start.agents)
        self._free = free_space(street.road_map.drivable_rings, street.middle_m, street.radius_m)
        self._shown: dict[str, tuple[Tensor, Int32 | None]] = {}

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        return to_arrays(self._draw_tensors(snapshot, views))

    def _draw_tensors(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, Tensor]:
        """Draw images on the model's device: agents and their shadows are put into them there."""
        begin = time.thread_time()
        instant = self.layer.at(snapshot)
        boxes = _ground_boxes(self._street, snapshot)
        self.seconds.add("agents", begin)
        images: dict[str, Tensor] = {}
        # Threads do not know whether plain torch is requested.
        put = self._put_compiled if runs_kernels(self._model.device) else self._put_elsewhere

        def work(number: int) -> None:
            view = views[number]
            clock = time.thread_time()
            agents = self._draw_agents(instant, view, snapshot.time_s)
            clock = self.seconds.add("agents", clock)
            seen = self._render_view(view, snapshot)
            limit_m = None if agents is None else hiding_depth(agents)
            empty = self._draw_background(seen, limit_m)
            clock = self.seconds.add("street", clock)
            rgb, shown = _put_in_bands(put, self._bands(view), empty, agents, boxes)
            self._shown[view.name] = shown, None if agents is None else agents.number
            noise = np.random.SeedSequence([self._seed, number, snapshot.step]).generate_state(1, np.uint64)[0]
            images[view.name] = self._expose(seen, rgb, int(noise))
            self.seconds.add("composition", clock)

        in_parallel(work, len(views))
        return {view.name: images[view.name] for view in views}

    def _bands(self, view: CameraView) -> list[Band]:
        return list(cut_bands(view.camera, view.world_SE3_camera, self._shutter_of(view)))

    def _shutter_of(self, view: CameraView) -> ViewShutter | None:
        """Return the shutter through which agents are seen: models on a GPU show the street at mid-exposure."""
        return None if self._model.device.startswith("cuda") else view.shutter

    def _draw_agents(self, instant: Instant, view: CameraView, time_s: float) -> AgentImage | None:
        shutter = self._shutter_of(view)
        if shutter is None:
            return self.layer.draw(instant, view.camera, view.world_SE3_camera)
        return self.layer.draw_lines(instant, view.camera, shutter, time_s)

    def _put_compiled(
        self, band: Band, empty: _Background, agents: AgentImage | None, boxes: Float64
    ) -> tuple[Tensor, Tensor]:
        """Put agents and their shadows into an image by compiled kernels; return it, and (H, W) where it shows one."""
        rgb, depth_m, covered = (part.numpy() for part in (empty.rgb, empty.depth_m, empty.covered))
        camera = band.lens, band.rotation, band.origin
        add_contact_shadows(rgb, depth_m, *camera, boxes)
        if agents is None:
            return empty.rgb, torch.zeros(depth_m.shape, dtype=torch.bool)
        image, shown = compose(rgb, depth_m, covered, agents, *camera, self._free)
        return torch.from_numpy(image), torch.from_numpy(shown)

    def _put_elsewhere(
        self, band: Band, empty: _Background, agents: AgentImage | None, boxes: Float64
    ) -> tuple[Tensor, Tensor]:
        """Do as `_put_compiled`, in plain torch on the device of the image."""
        camera = band.lens, band.rotation, band.origin
        plain.add_contact_shadows(empty.rgb, empty.depth_m, *camera, boxes)
        if agents is None:
            return empty.rgb, torch.zeros_like(empty.depth_m, dtype=torch.bool)
        layer = plain.AgentTensors(self._move(agents.rgb), self._move(agents.alpha), self._move(hiding_depth(agents)))
        free = self._move(self._free.is_free)
        return plain.compose(empty.rgb, empty.depth_m, empty.covered, layer, *camera, free, self._free.origin_m)

    def _move(self, array: AnyArray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._model.device)

    def draw_empty(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, Tensor]:
        """Return the images (H, W, 3), RGB, uint8, of the street without agents, all at one instant, on its device."""
        images: dict[str, Tensor] = {}

        def work(number: int) -> None:
            seen = self._render_view(views[number], snapshot)
            images[seen.camera] = self._expose(seen, self._draw_background(seen, None).rgb, None)

        in_parallel(work, len(views))
        return images

    def agent_masks(self) -> Mapping[str, Int32]:
        """Return, for the last images, the number (H, W) of the agent that each pixel shows; -1: none."""
        masks = {}
        for name, (shown, number) in self._shown.items():
            is_shown = shown.cpu().numpy()
            masks[name] = np.where(is_shown, -1 if number is None else number, -1).astype(np.int32)
        return masks

    def _render_view(self, place: CameraView, snapshot: Snapshot) -> RenderView:
        camera = place.camera
        recording = self._street.recordings.get(self._appearance)
        return RenderView(
            path=f"{place.name}/{snapshot.step}", group="simulation", scene_id=self._street.scene_id,
            traversal_id=self._appearance, frame_index=snapshot.step, camera=place.name, timestamp_ns=snapshot.stamp_ns,
            light=recording.light if recording else "day", weather=recording.weather if recording else "clear",
            model="pinhole", width_px=camera.width_px, height_px=camera.height_px, fx_px=camera.fx_px,
            fy_px=camera.fy_px, cx_px=camera.cx_px, cy_px=camera.cy_px, distortion=(),
            world_SE3_camera=place.world_SE3_camera, shutter=place.shutter,
        )  # fmt: skip

    def _expose(self, view: RenderView, rgb: Tensor, noise_seed: int | None) -> Tensor:
        """The image that the camera takes of the unexposed street with its agents."""
        if not self._model.renderer.capabilities.separates_exposure:
            return rgb
        return _to_levels(torch.as_tensor(self._model.renderer.expose(view, rgb.float() / 255.0, noise_seed)))

    def _draw_background(self, view: RenderView, limit_m: Float32 | None) -> _Background:
        """The empty street, and the share of each pixel that it covers before a depth (H, W)."""
        renderer, covers = self._model.renderer, None
        if renderer.capabilities.separates_exposure:
            rendering, covers = renderer.render_unexposed(view, limit_m)
        elif limit_m is not None and renderer.capabilities.renders_covers:
            rendering, covers = renderer.render_covers(view, limit_m)
        else:
            rendering = renderer.render(view)
        colours, alpha, depth_m = (
            torch.as_tensor(part).detach().to(self._model.device)
            for part in (rendering.rgb, rendering.alpha, rendering.depth_m)
        )
        # Where the model shows hardly anything, nothing hides an agent.
        depth_m = torch.where(alpha > 0.5, depth_m, 0.0).float().contiguous()
        covered = torch.zeros_like(depth_m)
        if covers is not None:
            covered = torch.as_tensor(covers).detach().to(depth_m)
        elif limit_m is not None:
            # Only the mean depth is known.
            covered = ((depth_m > 0.0) & (depth_m < self._move(limit_m))).float()
        return _Background(_to_levels(colours), depth_m, covered)


@dataclass(frozen=True, eq=False)
class _Background:
    """An image of the empty street.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth_m: (H, W) camera z; 0 where hardly anything is.
        covered: (H, W) share of each pixel that the street before the agents covers.
    """

    rgb: Tensor
    depth_m: Tensor
    covered: Tensor

    def cut(self, place: tuple[slice, slice]) -> _Background:
        """Return a part of the image, with memory in one piece."""
        return _Background(*(part[place].contiguous() for part in (self.rgb, self.depth_m, self.covered)))


_Put: TypeAlias = Callable[[Band, _Background, AgentImage | None, Float64], tuple[Tensor, Tensor]]


def _put_in_bands(
    put: _Put, bands: Sequence[Band], empty: _Background, agents: AgentImage | None, boxes: GroundBoxes
) -> tuple[Tensor, Tensor]:
    """Put agents and their shadows into the bands of an image, which follow each other along one side."""
    parts = [
        put(
            band,
            empty.cut(band.place),
            None if agents is None else agents.cut(band.place),
            boxes.at(band.offset_s),
        )
        for band in bands
    ]
    if len(parts) == 1:
        return parts[0]
    side = 0 if bands[0].place[1] == slice(None) else 1
    return torch.cat([rgb for rgb, _ in parts], dim=side), torch.cat([shown for _, shown in parts], dim=side)


def _to_levels(colours: Tensor) -> Tensor:
    return colours.clamp(0.0, 1.0).mul(255.0).add(0.5).byte().contiguous()


def choose_appearance(model: OpenModel, street: Street, scenario: Scenario) -> str:
    """Return the trained traversal whose light and weather match the scenario's best."""

    def mismatch(name: str) -> tuple[bool, bool, str]:
        recording = street.recordings.get(name)
        if recording is None:
            return True, True, name
        return recording.light != scenario.light, recording.weather != scenario.weather, name

    return min(model.trained, key=mismatch)


def _condition(street: Street, traversal: str, scenario: Scenario) -> Condition:
    """Light and weather of the agents: those of the trained traversal."""
    recording: StreetRecording | None = street.recordings.get(traversal)
    light, weather = (scenario.light, scenario.weather)
    if recording is not None:
        light = recording.light if recording.light in ("day", "dusk", "night") else light  # type: ignore[assignment]
        weather = recording.weather if recording.weather in ("clear", "clouds", "rain") else weather  # type: ignore[assignment]
    known = street.roi is not None and street.roi.longitude_deg is not None
    if recording is not None and known:
        return Condition(recording.start_ns, light, weather)
    return Condition(instant_of("2025-06-21", light, *_NO_POSITION), light, weather)


class GroundBoxes(NamedTuple):
    """The agents near the ego, as rectangles on the ground.

    Attributes:
        boxes: (N, 6) x, y, height of the ground, yaw, half length and half width.
        velocity_mps: (N, 2) velocities along x and y.
    """

    boxes: Float64
    velocity_mps: Float64

    def at(self, offset_s: float) -> Float64:
        """Return the boxes at a time from the instant."""
        if not offset_s:
            return self.boxes
        return np.concatenate([self.boxes[:, :2] + offset_s * self.velocity_mps, self.boxes[:, 2:]], axis=1)


def _ground_boxes(street: Street, snapshot: Snapshot) -> GroundBoxes:
    states, ego = snapshot.states, snapshot.ego
    near = states.present & (np.hypot(states.x_m - ego.x_m, states.y_m - ego.y_m) < _NEAR_M)
    rows = np.flatnonzero(near)
    if not len(rows):
        return GroundBoxes(np.zeros((0, 6)), np.zeros((0, 2)))
    sizes = 0.5 * np.array([snapshot.agents[row].size_m[:2] for row in rows])
    height = np.asarray(street.ground.height_m(states.x_m[rows], states.y_m[rows]))
    boxes = np.column_stack([states.x_m[rows], states.y_m[rows], height, states.yaw_rad[rows], sizes])
    return GroundBoxes(boxes, np.column_stack([states.vx_mps[rows], states.vy_mps[rows]]))
