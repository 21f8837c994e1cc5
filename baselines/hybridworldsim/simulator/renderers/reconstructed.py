"""A reconstructed street: a trained model's images of the empty street, with agents composed into them."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.agent_layer import AgentLayer
from hybridworldsim.simulator.renderers.compositing import (
    add_contact_shadows,
    compose,
    free_space,
    hiding_depth,
)
from hybridworldsim.simulator.renderers.protocol import CameraView, Renderer
from hybridworldsim.simulator.street.street import Street, StreetRecording
from hybridworldsim.simulator.world import Snapshot
from mirror.arrays import Bool, Float32, Float64, Int32, UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.geometry import matrix_from_quaternion
from mirror.methods.model import ModelFolder, ModelRenderer
from mirror.methods.model_document import Reconstruction, read_reconstruction, require_finished
from mirror.protocols.views.view import RenderView
from mirror.schema.scenario import Scenario
from mirror.synth import Condition, instant_of

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
    """

    path: Path
    scene: str
    trained: tuple[str, ...]
    renderer: ModelRenderer

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
        return cls(path, document.scene, trained or tuple(sorted(document.trained)), renderer)


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
        self._shown: dict[str, Int32] = {}

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        begin = time.thread_time()
        instant = self.layer.at(snapshot)
        boxes = _ground_boxes(self._street, snapshot)
        self.seconds.add("agents", begin)
        images: dict[str, UInt8] = {}

        def work(number: int) -> None:
            view = views[number]
            clock = time.thread_time()
            agents = self.layer.draw(instant, view.camera, view.world_SE3_camera)
            clock = self.seconds.add("agents", clock)
            seen = self._render_view(view, snapshot)
            rgb, depth, covered = self._background(seen, None if agents is None else hiding_depth(agents))
            clock = self.seconds.add("street", clock)
            rotation = matrix_from_quaternion(view.world_SE3_camera.rotation)[0]
            origin, lens = view.world_SE3_camera.translation[0], view.camera
            numbers = np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px])
            add_contact_shadows(rgb, depth, numbers, rotation, origin, boxes)
            shown: Bool = np.zeros(depth.shape, np.bool_)
            if agents is not None:
                rgb, shown = compose(rgb, depth, covered, agents, numbers, rotation, origin, self._free)
            self._shown[view.name] = np.where(shown, -1 if agents is None else agents.number, -1).astype(np.int32)
            noise = np.random.SeedSequence([self._seed, number, snapshot.step]).generate_state(1, np.uint64)[0]
            images[view.name] = self._expose(seen, rgb, int(noise))
            self.seconds.add("composition", clock)

        in_parallel(work, len(views))
        return {view.name: images[view.name] for view in views}

    def draw_empty(self, snapshot: Snapshot, views: Sequence[CameraView]) -> Mapping[str, UInt8]:
        """Return the images (H, W, 3), RGB, of the street without agents, all at one instant."""
        images: dict[str, UInt8] = {}

        def work(number: int) -> None:
            seen = self._render_view(views[number], snapshot)
            images[seen.camera] = self._expose(seen, self._background(seen, None)[0], None)

        in_parallel(work, len(views))
        return images

    def agent_masks(self) -> Mapping[str, Int32]:
        """Return, for the last images, the number (H, W) of the agent that each pixel shows; -1: none."""
        return self._shown

    def _render_view(self, place: CameraView, snapshot: Snapshot) -> RenderView:
        camera = place.camera
        recording = self._street.recordings.get(self._appearance)
        return RenderView(
            path=f"{place.name}/{snapshot.step}", group="simulation", scene_id=self._street.scene_id,
            traversal_id=self._appearance, frame_index=snapshot.step, camera=place.name, timestamp_ns=snapshot.stamp_ns,
            light=recording.light if recording else "day", weather=recording.weather if recording else "clear",
            model="pinhole", width_px=camera.width_px, height_px=camera.height_px, fx_px=camera.fx_px,
            fy_px=camera.fy_px, cx_px=camera.cx_px, cy_px=camera.cy_px, distortion=(),
            world_SE3_camera=place.world_SE3_camera,
        )  # fmt: skip

    def _expose(self, view: RenderView, rgb: UInt8, noise_seed: int | None) -> UInt8:
        """The image that the camera takes of the unexposed street with its agents."""
        if not self._model.renderer.capabilities.separates_exposure:
            return rgb
        image = self._model.renderer.expose(view, torch.from_numpy(rgb).float() / 255.0, noise_seed)
        return _to_levels(torch.as_tensor(image))

    def _background(self, view: RenderView, limit_m: Float32 | None) -> tuple[UInt8, Float32, Float32]:
        """The empty street: its image, its depth, and the share of each pixel that it covers before a depth (H, W)."""
        renderer, covers = self._model.renderer, None
        if renderer.capabilities.separates_exposure:
            rendering, covers = renderer.render_unexposed(view, limit_m)
        elif limit_m is not None and renderer.capabilities.renders_covers:
            rendering, covers = renderer.render_covers(view, limit_m)
        else:
            rendering = renderer.render(view)
        colours, alpha, depth_m = (
            torch.as_tensor(part).detach() for part in (rendering.rgb, rendering.alpha, rendering.depth_m)
        )
        rgb = _to_levels(colours)
        # Where the model shows hardly anything, nothing hides an agent.
        depth = np.where(alpha.cpu().numpy() > 0.5, depth_m.cpu().numpy(), 0.0).astype(np.float32)
        covered: Float32 = np.zeros(depth.shape, np.float32)
        if covers is not None:
            covered = torch.as_tensor(covers).detach().cpu().numpy().astype(np.float32)
        elif limit_m is not None:
            # Only the mean depth is known.
            covered = ((depth > 0.0) & (depth < limit_m)).astype(np.float32)
        return rgb, np.ascontiguousarray(depth), covered


def _to_levels(colours: torch.Tensor) -> UInt8:
    return np.ascontiguousarray(colours.clamp(0.0, 1.0).mul(255.0).add(0.5).byte().cpu().numpy())


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


def _ground_boxes(street: Street, snapshot: Snapshot) -> Float64:
    """(N, 6) x, y, height of the ground, yaw, half length and half width of the agents near the ego."""
    states, ego = snapshot.states, snapshot.ego
    near = states.present & (np.hypot(states.x_m - ego.x_m, states.y_m - ego.y_m) < _NEAR_M)
    rows = np.flatnonzero(near)
    if not len(rows):
        return np.zeros((0, 6))
    sizes = 0.5 * np.array([snapshot.agents[row].size_m[:2] for row in rows])
    height = np.asarray(street.ground.height_m(states.x_m[rows], states.y_m[rows]))
    return np.column_stack([states.x_m[rows], states.y_m[rows], height, states.yaw_rad[rows], sizes])
