"""Images that stay on the device: composition in plain torch, renderers' tensors, and policies that ask for them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.protocol import Observation, ObservationSpec
from hybridworldsim.simulator.renderers import plain_compositing as plain
from hybridworldsim.simulator.renderers.agent_layer import AgentImage
from hybridworldsim.simulator.renderers.compositing import add_contact_shadows, compose, free_space, hiding_depth
from hybridworldsim.simulator.renderers.protocol import rig_cameras, to_arrays
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.rollout.run import run_rollout
from hybridworldsim.simulator.simulation import Simulation
from mirror.errors import UsageError
from mirror.methods.capabilities import Capabilities
from mirror.methods.model import ModelRenderer
from mirror.protocols.sensor_faults import SensorFault
from mirror.schema.rollout import STATES_FILE
from tests.simulator.generated_street import CAMERAS, HEIGHT, WIDTH, FlatStreet, renderer_of, start
from tests.simulator.requests import request
from tests.simulator.streets import EGO_R_CAMERA
from tests.training.shadow import DEVICE, WAITS, OnShadows

SIZE = (54, 96)
LENS, CAMERA = np.array([60.0, 60.0, 48.0, 27.0]), np.array([3.0, -1.0, 1.5])


def scene(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, AgentImage]:
    """A street of random colours on level ground with walls and mist, and agents that cover parts of pixels."""
    rng = np.random.default_rng(seed)
    below = np.maximum((np.arange(SIZE[0])[:, None] + 0.5 - LENS[3]) / LENS[1], 1e-9)
    depth = np.minimum(CAMERA[2] / below, rng.uniform(6.0, 60.0, (1, SIZE[1]))).astype(np.float32)
    depth[:5] = 0.0
    alpha = np.where(rng.random(SIZE) < 0.4, 0.0, rng.random(SIZE)).astype(np.float32)
    alpha[20:40, 10:60] = 1.0
    agents = AgentImage(
        rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8), alpha,
        np.where(alpha > 0.0, rng.uniform(2.0, 50.0, SIZE), np.inf).astype(np.float32), np.zeros(SIZE, np.int32),
    )  # fmt: skip
    return rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8), depth, rng.random(SIZE).astype(np.float32), agents


@pytest.mark.parametrize("seed", range(3))
def test_composition_in_plain_torch_has_the_bytes_of_the_kernels(seed: int) -> None:
    rgb, depth, covered, agents = scene(seed)
    ring = np.array([(0.0, -6.0), (40.0, -6.0), (40.0, 4.0), (0.0, 4.0)])
    free = free_space([ring], (0.0, 0.0), 30.0)
    camera = LENS, EGO_R_CAMERA, CAMERA
    image, shown = compose(rgb, depth, covered, agents, *camera, free)
    tensors = [torch.from_numpy(one) for one in (rgb, depth, covered, agents.rgb, agents.alpha, hiding_depth(agents))]
    found, where = plain.compose(
        *tensors[:3], plain.AgentTensors(*tensors[3:]), *camera, torch.from_numpy(free.is_free), free.origin_m
    )
    assert 0.2 < shown.mean() < 0.8 and (image != rgb).any()
    np.testing.assert_array_equal(where.numpy(), shown)
    np.testing.assert_array_equal(found.numpy(), image)


@pytest.mark.parametrize("seed", range(3))
def test_shadows_in_plain_torch_have_the_bytes_of_the_kernels(seed: int) -> None:
    """Boxes that overlap, one behind the camera, one too far away, one whose area begins before the near plane."""
    rgb, depth, _, _ = scene(seed)
    boxes = np.array([
        [12.0, -1.0, 0.0, 0.4, 2.3, 0.9], [14.5, 0.5, 0.1, -0.2, 2.0, 0.9], [-9.0, 0.0, 0.0, 0.0, 2.0, 0.9],
        [90.0, 0.0, 0.0, 0.0, 2.0, 0.9], [5.0, -1.0, 0.0, 1.0, 2.0, 0.9],
    ])  # fmt: skip
    expected, found = rgb.copy(), torch.from_numpy(rgb.copy())
    add_contact_shadows(expected, depth, LENS, EGO_R_CAMERA, CAMERA, boxes)
    plain.add_contact_shadows(found, torch.from_numpy(depth), LENS, EGO_R_CAMERA, CAMERA, boxes)
    assert (expected != rgb).mean() > 0.02
    assert (np.abs(found.numpy().astype(int) - expected) > 0).mean() < 1e-3
    assert np.abs(found.numpy().astype(int) - expected).max() <= 1


def street_renderer(simulation: Simulation, device: str = "cpu") -> ReconstructedRenderer:
    cameras = rig_cameras(simulation.street, CAMERAS, 4 * WIDTH, 4 * HEIGHT)
    model = ModelRenderer("flat", FlatStreet(), Capabilities(renders_depth=True))
    street = OpenModel(Path(), simulation.street.scene_id, ("drive-1",), model, device)
    return ReconstructedRenderer(street, simulation.street, simulation.scenario, simulation.now, cameras)


@contextmanager
def one_thread() -> Iterator[None]:
    """Cameras are rendered in the thread of the caller, where the stand-in for a GPU is known."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def test_images_of_a_street_stay_on_its_device_and_have_the_bytes_of_the_cpu() -> None:
    simulation = start()
    here = street_renderer(simulation)
    images, tensors = here.render(simulation.now, CAMERAS), here.render_tensors(simulation.now, CAMERAS)
    masks = here.agent_masks()
    assert here.rendered == 4 and any((mask >= 0).any() for mask in masks.values())
    with plain_torch():
        elsewhere = street_renderer(simulation).render(simulation.now, CAMERAS)
    with one_thread(), OnShadows():
        there = street_renderer(simulation, DEVICE)
        WAITS.clear()
        placed = there.render_tensors(simulation.now, CAMERAS)
        # What is there already is not read back: images and masks go to the device only.
        assert not {"tolist", "_local_scalar_dense"} & set(WAITS)
        assert {image.device.type for image in placed.values()} == {DEVICE}
        read = {name: image.cpu().numpy() for name, image in placed.items()}
        found = there.agent_masks()
    for name, image in images.items():
        assert tensors[name].dtype == torch.uint8 and tensors[name].device.type == "cpu"
        for other in (tensors[name].numpy(), elsewhere[name], read[name]):
            np.testing.assert_array_equal(other, image)
        np.testing.assert_array_equal(found[name], masks[name])


def test_generated_road_users_have_the_same_bytes_as_tensors(opened, models) -> None:
    simulation = start()
    arrays, tensors = (renderer_of(simulation, opened, models) for _ in range(2))
    for _ in range(7):
        images, others = arrays.render(simulation.now, CAMERAS), tensors.render_tensors(simulation.now, CAMERAS)
        for name, image in images.items():
            np.testing.assert_array_equal(to_arrays(others)[name], image)
        simulation.advance(Controls(0.0, 0.0))
    assert arrays.view_counts() == tensors.view_counts() and arrays.view_counts()["generated"] > 0


class Reader:
    """Brakes by the brightness of its image, which it gets in a form."""

    cameras, privileged = ("front_wide",), False

    def __init__(self, form: str | None) -> None:
        self.seen: list[Observation] = []
        if form is not None:
            self.image_form = form

    def reset(self, spec: ObservationSpec) -> None:
        pass

    def act(self, observation: Observation) -> Controls:
        self.seen.append(observation)
        image = (observation.tensors or observation.images)["front_wide"]
        total = int(np.asarray(image).astype(np.int64).sum())
        return Controls(-1.0 - 0.1 * (total % 7), 0.0)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("fault", [None, SensorFault(name="x", noise=9.0, late_steps=1)])
def test_a_policy_gets_tensors_if_it_asks_for_them(fault: SensorFault | None, tmp_path: Path) -> None:
    policies = {form: Reader(form) for form in (None, "numpy", "torch")}
    for form, policy in policies.items():
        run_rollout(request(policy, sensors=fault, video=("rear",)), tmp_path / str(form))
    default, arrays, tensors = policies.values()
    assert len({(tmp_path / str(form) / STATES_FILE).read_bytes() for form in policies}) == 1
    for one, other, third in zip(default.seen, arrays.seen, tensors.seen, strict=True):
        assert not one.tensors and not other.tensors and not third.images
        image, tensor = one.images["front_wide"], third.tensors["front_wide"]
        assert isinstance(image, np.ndarray) and isinstance(tensor, torch.Tensor)
        assert tensor.dtype == torch.uint8 and tensor.numpy().tobytes() == image.tobytes()
        assert other.images["front_wide"].tobytes() == image.tobytes()


def test_another_form_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"policy 'test': image_form is 'jax'; expected one of numpy, torch"):
        run_rollout(replace(request(Reader("jax"))), tmp_path / "run")
    assert not (tmp_path / "run").exists()
