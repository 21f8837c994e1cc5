"""Messages for AlpaSim's generated code to read. ``python -m tests.peers alpasim`` lets it do so in an environment of
its own; the tests compare ``tests/peers/alpasim/result.json`` with these messages.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import json_format

from hybridworldsim.simulator.ego.vehicle import EgoState, VehicleParameters
from hybridworldsim.simulator.policies.protocol import Observation, ObservationSpec
from hybridworldsim.simulator.remote.driver_file import DriverFile
from hybridworldsim.simulator.remote.policy import RemotePolicy
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from tests.simulator.drivers import Driver, serving, straight_on
from tests.simulator.served import car_at, request, service
from tests.simulator.streets import straight_street

RESULT = Path(__file__).resolve().parents[1] / "peers" / "alpasim" / "result.json"


def sample_messages() -> list[Any]:
    """Messages of a session with one step, of its answers, and of the service that renders."""
    street, driver = straight_street(), Driver(straight_on(7.0))
    file = DriverFile(cameras={"front_wide": "camera_front_wide_120fov", "rear": "back"}, lens="f_theta")
    with serving(driver):
        policy = RemotePolicy(driver.address, file)
        policy.reset(ObservationSpec(rig_cameras(street, ("front_wide", "rear"), 48), VehicleParameters(), 0.1, 2**40))
        route = np.column_stack([2.0 * np.arange(40), np.zeros(40)])
        route[20:] = route[19]
        images = dict.fromkeys(("front_wide", "rear"), np.full((27, 48, 3), 90, np.uint8))
        ego, odometry = EgoState(0.0, 0.0, 0.0, 8.5, -1.2, 0.1), np.array([1.5, -0.25, 0.3])
        policy.act(Observation(1_700_000_000_123_456_789, images, ego, route, odometry))
        policy.close()
    # Images arrive in any order.
    calls = sorted((message for _, message in driver.calls), key=lambda message: message.DESCRIPTOR.name)
    for message in calls:
        message.session_uuid = "0123456789abcdef"
    calls = sorted(calls, key=lambda message: message.SerializeToString(deterministic=True))
    renders = service()
    asked = request(dynamic_objects=[car_at(112.0, -1.75)], image_quality=95.0)
    answers = [
        driver.answer(0, driver, None),
        renders.calls()["get_version"][1](None),
        renders.list_scenes(None),
        renders.list_cameras(request()),
        asked,
    ]
    return [*calls, *answers]


def write_messages(folder: Path) -> None:
    """Write the messages: their bytes, and their fields as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [
        {
            "message": message.DESCRIPTOR.name,
            "bytes": base64.b64encode(message.SerializeToString(deterministic=True)).decode(),
            "fields": json_format.MessageToDict(message, preserving_proto_field_name=True),
        }
        for message in sample_messages()
    ]
    (folder / "messages.json").write_text(json.dumps(rows, indent=0))


INPUTS = {"alpasim": write_messages}
"""Writers of the folders that ``python -m tests.peers`` lets the toolkit read."""
