"""A street with headlights, exposure and noise: decoded, composed, stored, trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.light.exposure_controller import ExposureController
from hybridworldsim.light.light_training import LightTraining
from hybridworldsim.light.recorded_light import RecordedCamera, RecordedLight, group_of
from hybridworldsim.light.sensor_noise import SensorNoise
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.settings import LightSettings
from hybridworldsim.model.storage import load_block, save_block
from hybridworldsim.model.street import StreetModel
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import Source, to_viewpoint
from tests.interruption import interrupt_at_call
from tests.model import streets
from tests.training import short_run
from tests.training import street as training_street

DAY, NIGHT = Source("s.a.0", "front_wide"), Source("s.b.1", "front_wide")
BLOCK = Block((0, 0), (0.0, 0.0, 0.0))


def lit_street() -> StreetModel:
    """The street of `streets`, recorded by day and at night by a camera 1.5 m above the ground."""
    plain = streets.street()
    camera = np.eye(4)
    camera[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    camera[2, 3] = 1.5
    light = RecordedLight([RecordedCamera(DAY, "day", camera), RecordedCamera(NIGHT, "night", camera)], headlights=True)
    assert light.headlights is not None
    with torch.no_grad():
        light.headlights.out.bias.fill_(1.0)
    plain.appearance.add(NIGHT, torch.full((8,), 0.3))
    return StreetModel(plain.background, plain.ground, plain.sky, plain.appearance, light)


@torch.no_grad()
def test_headlights_light_what_the_vehicle_sees_at_night_and_nothing_by_day() -> None:
    street = lit_street()
    assert street.light is not None and street.light.headlights is not None
    viewpoint = to_viewpoint(streets.view(), np.zeros(3)).with_source(NIGHT)
    latent = street.appearance(NIGHT)
    dark = street.decode(viewpoint, latent, latent)
    lamps = street.lamps(viewpoint, NIGHT)
    assert lamps is not None and street.lamps(viewpoint, DAY) is None
    lit = street.decode(viewpoint, latent, latent, None, lamps)
    by_day = street.decode(viewpoint, street.appearance(DAY), latent)
    # The camera's mounting puts the vehicle's frame at the world's, less the height of the view.
    ego = torch.eye(4)
    for number, ground in ((0, False), (1, True)):
        light = street.light.headlights(dark[number].means, ego, ground=ground).double()
        expected = (dark[number].colours.double() ** 2.2 + light * by_day[number].colours.double() ** 2.2) ** (1 / 2.2)
        torch.testing.assert_close(lit[number].colours.double(), expected, rtol=1e-3, atol=3e-3)
        assert (lit[number].colours > dark[number].colours + 1e-3).any()
    assert torch.equal(lit[2].colours, dark[2].colours)


@torch.no_grad()
def test_a_composed_block_is_lit_as_the_block_alone() -> None:
    street, view = lit_street(), streets.view()
    viewpoint = to_viewpoint(view, np.zeros(3)).with_source(NIGHT)
    alone = street(viewpoint, street.appearance(NIGHT)).rgb
    latent = street.appearance(NIGHT)
    composed, _ = Composition([(BLOCK, street)]).render(
        view, lambda _: (latent, latent), lambda part, seen: part.lamps(seen.with_source(NIGHT), NIGHT)
    )
    torch.testing.assert_close(composed.rgb, alone, rtol=1e-4, atol=1e-4)
    off, _ = Composition([(BLOCK, street)]).render(view, lambda _: (latent, latent))
    assert float((alone - off.rgb).abs().max()) > 0.02


def test_stored_light_is_restored(tmp_path: Path) -> None:
    street = lit_street()
    assert street.light is not None
    controller = ExposureController(np.arange(6.0), np.arange(5.0), -0.5, 0.5)
    street.light.controllers = {group_of(NIGHT): controller}
    street.light.noise, street.light.width_px = {group_of(NIGHT): SensorNoise((0.01, 0.02))}, 96
    save_block(tmp_path / "model.safetensors", BLOCK, street)
    _, again, _ = load_block(tmp_path / "model.safetensors")
    assert again.light is not None
    assert again.light.document() == street.light.document()
    for (name, ours), (same, theirs) in zip(street.named_parameters(), again.named_parameters(), strict=True):
        assert name == same and torch.equal(ours, theirs)
    colours = torch.rand(20, 30, 3)
    assert torch.equal(street.light.respond(colours, NIGHT), again.light.respond(colours, NIGHT))
    assert again.light.noise_at(NIGHT, 192) == SensorNoise((0.02, 0.04)) and again.light.noise_at(DAY, 192) is None


def recorded_images(light: RecordedLight, count: int) -> list[tuple[torch.Tensor, TrainingImage, float]]:
    """Colours of a street, and what a camera with another gain for each took of them."""
    random = torch.Generator().manual_seed(9)
    viewpoint = to_viewpoint(streets.view(), np.zeros(3)).with_source(DAY)
    levels = 0.15 + 0.5 * np.arange(count) / count
    middle = float(np.log(levels).mean())
    made = []
    for number, level in enumerate(levels.tolist()):
        colours = (level + 0.3 * torch.rand(54, 96, 3, generator=random)).clamp(0.05, 0.9)
        log_gain = -0.8 * (float(np.log(level)) - middle)
        with torch.no_grad():
            rgb = light.response(colours, DAY.camera, log_gain).clamp(0.0, 1.0)
        scored = torch.ones(54, 96, dtype=torch.bool)
        made.append((colours, TrainingImage(viewpoint, rgb, scored, None, None, f"{number}"), log_gain))
    return made


def test_training_finds_the_gains_and_the_law_of_exposure_and_continues_after_an_interruption() -> None:
    light = RecordedLight([RecordedCamera(DAY, "day", np.eye(4))], headlights=True)
    assert light.headlights is None  # nothing was recorded in the dark
    images = recorded_images(light, 16)
    whole, first = LightTraining(light), LightTraining(light)
    for colours, image, _ in 5 * images:
        whole.respond(colours, image, 0.5)
    for colours, image, _ in 2 * images:
        first.respond(colours, image, 0.5)
    second = LightTraining(light)
    second.restore(first.state())
    for colours, image, _ in 3 * images:
        second.respond(colours, image, 0.5)
    for colours, image, log_gain in images:
        assert whole.log_gain(image.name, group_of(DAY)) == pytest.approx(log_gain, abs=0.02)
        assert second.log_gain(image.name, group_of(DAY)) == whole.log_gain(image.name, group_of(DAY))
        error = float((whole.respond(colours, image, 0.5).detach() - image.rgb).abs().mean())
        assert error < 0.3 * float((colours - image.rgb).abs().mean()) + 0.01
    whole.finish()
    second.finish()
    assert light.noise.keys() == {group_of(DAY)}
    errors = [abs(light.log_gain(colours, DAY) - log_gain) for colours, _, log_gain in images]
    assert np.median(errors) < 0.08


def test_before_a_tenth_of_the_training_all_gains_are_one() -> None:
    light = RecordedLight([RecordedCamera(DAY, "day", np.eye(4))], headlights=False)
    ((colours, image, _),) = recorded_images(light, 1)
    training = LightTraining(light)
    assert torch.equal(training.respond(colours, image, 0.05), colours)
    assert training.log_gain("0", group_of(DAY)) == 0.0


def test_an_interrupted_training_ends_as_one_that_was_not(tmp_path: Path) -> None:
    def trainer() -> StreetTrainer:
        camera = np.eye(4)
        camera[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
        cameras = [
            RecordedCamera(Source(name, "front_wide"), name.split(".")[1], camera)
            for name in training_street.TRAVERSALS
        ]
        settings = LightSettings(**vars(training_street.SETTINGS))
        return StreetTrainer(initial_street(replace(training_street.initial(), cameras=cameras), settings), settings)

    interrupted = training_street.Painted(interrupt_at_call(lambda image: image, 17))
    at_once = short_run.run(tmp_path / "once", 40, trainer=trainer())
    with pytest.raises(KeyboardInterrupt):
        short_run.run(tmp_path / "twice", 40, trainer=trainer(), images=interrupted)
    resumed = short_run.run(tmp_path / "twice", 40, trainer=trainer())
    assert resumed.psnr_db == at_once.psnr_db
    models = [(tmp_path / name / "model.safetensors").read_bytes() for name in ("once", "twice")]
    assert models[0] == models[1]
