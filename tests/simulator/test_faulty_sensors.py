"""Faults of sensors: what each does to the images and the mountings."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.rollout.faulty_sensors import FaultySensors
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.protocols.sensor_faults import SensorFault

IMAGES = {
    "front": np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3),
    "rear": np.full((6, 8, 3), 200, np.uint8),
}


def test_sound_sensors_change_nothing() -> None:
    for fault in (None, SensorFault(name="sound")):
        seen = FaultySensors(fault, 1).change(IMAGES, 0, 0.0)
        assert all(np.array_equal(seen[name], image) for name, image in IMAGES.items())


@pytest.mark.parametrize("stops", [2.0, -1.0])
def test_exposure_multiplies_light(stops: float) -> None:
    seen = FaultySensors(SensorFault(name="x", exposure_stops=stops), 1).change(IMAGES, 0, 0.0)
    for name, image in IMAGES.items():
        light = np.clip(2.0**stops * (image / 255.0) ** 2.2, 0.0, 1.0)
        np.testing.assert_allclose(seen[name], 255.0 * light ** (1.0 / 2.2), atol=0.5 + 1e-9)


def test_noise_has_its_strength_and_follows_from_seed_camera_and_step() -> None:
    grey = {"a": np.full((200, 200, 3), 128, np.uint8), "b": np.full((200, 200, 3), 128, np.uint8)}
    fault = SensorFault(name="x", noise=12.0)
    first = FaultySensors(fault, 1).change(grey, 3, 0.6)
    assert np.std(first["a"]) == pytest.approx(12.0, rel=0.02)
    assert np.mean(first["a"]) == pytest.approx(128.0, abs=0.2)
    again = FaultySensors(fault, 1).change(grey, 3, 0.6)
    assert np.array_equal(first["a"], again["a"])
    assert not np.array_equal(first["a"], first["b"])
    assert not np.array_equal(first["a"], FaultySensors(fault, 2).change(grey, 3, 0.6)["a"])
    assert not np.array_equal(first["a"], FaultySensors(fault, 1).change(grey, 4, 0.8)["a"])


def test_a_dropped_camera_is_black_from_its_time_on() -> None:
    sensors = FaultySensors(SensorFault(name="x", dropped=("front",), after_s=1.0), 1)
    assert np.array_equal(sensors.change(IMAGES, 4, 0.8)["front"], IMAGES["front"])
    seen = sensors.change(IMAGES, 5, 1.0)
    assert not seen["front"].any() and np.array_equal(seen["rear"], IMAGES["rear"])


def test_late_images_are_those_of_earlier_steps() -> None:
    sensors = FaultySensors(SensorFault(name="x", late_steps=2), 1)
    steps = [{"front": np.full((2, 2, 3), 10 + step, np.uint8)} for step in range(5)]
    seen = [int(sensors.change(images, step, 0.2 * step)["front"][0, 0, 0]) for step, images in enumerate(steps)]
    assert seen == [0, 0, 10, 11, 12]


def test_a_turned_mounting_turns_the_axis_and_keeps_the_place() -> None:
    camera = Camera("pinhole", 8, 6, 5.0, 5.0, 4.0, 3.0, ())
    # The optical axis along the vehicle's x.
    ahead = Poses(np.array([[0.5, -0.5, 0.5, -0.5]]), np.array([[1.5, 0.2, 1.4]]))
    fault = SensorFault(name="x", turned_deg=30.0)
    turned = FaultySensors(fault, 1).turn({"front": CameraSpec(camera, ahead)})["front"].ego_SE3_camera
    np.testing.assert_allclose(turned.translation, ahead.translation)
    axis = turned.matrix()[0, :3, 2]
    np.testing.assert_allclose(axis, [np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0], atol=1e-12)
