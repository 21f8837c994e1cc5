"""The command line of ``mirror serve``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mirror.addresses import require_listening
from mirror.command_line import help_text, parse_arguments
from mirror.devices import CPU
from mirror.errors import UsageError

_EXAMPLES = (
    "mirror serve demo/block/dataset demo/block/model",
    "mirror serve synth:tiny --port 50061",
)


@dataclass(frozen=True)
class Arguments:
    """Serve images of a street from any place, to another simulator, until Ctrl-C.

    The service is AlpaSim's SensorsimService: get_version, get_available_scenes, get_available_cameras,
    get_available_ego_masks, render_rgb and batch_render_rgb. Its scenes are the recorded traversals, its frame is that
    of the dataset's scene, and its road users are the recorded ones. It listens on this machine only, unless --host
    says otherwise; it is not encrypted and asks for no password.
    """

    source: Annotated[tyro.conf.Positional[str], help_text(metavar="DATASET|synth:PRESET")]
    """Folder or URL of a dataset, or a synthetic street, synth:PRESET[:SEED[:DRIVE]]."""
    model: Annotated[tyro.conf.Positional[Path | None], help_text(default="none", metavar="MODEL")] = None
    """Folder of a model of the scene, which `mirror reconstruct` wrote: it renders the images."""
    renderer: Annotated[
        Literal["boxes", "exact", "reconstructed"] | None,
        help_text(default="reconstructed for a model, exact for a synthetic street, else boxes"),
    ] = None
    """Renderer of the images: wireframes, the synthetic street, a trained model."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of MODEL's method, if that is not installed: that of the training."""
    device: Annotated[str | None, help_text(default="auto", metavar="auto|cpu|cuda[:N]")] = None
    """Device that renders MODEL. auto: a GPU that torch and gsplat can use, else the CPU. The first line says which."""
    scene: Annotated[str | None, help_text(default="the only one", metavar="ID")] = None
    """Scene of the dataset."""
    host: str = "127.0.0.1"
    """Address of the interface; 0.0.0.0 lets other machines connect."""
    port: int = 50051
    """Port; 0 takes a free one."""
    rate: Annotated[float, help_text(metavar="IMAGES")] = 200.0
    """Greatest number of images in a second; further requests are refused with RESOURCE_EXHAUSTED."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror serve", examples=_EXAMPLES)
    require_listening(arguments.host, arguments.port)
    if not 0.0 < arguments.rate <= 1e6:
        raise UsageError(f"{arguments.rate:g} images", place="--rate", expected="a number above 0, at most 1e6")

    from hybridworldsim.simulator.remote.messages import SENSOR_SERVICE, wire
    from hybridworldsim.simulator.remote.scenes import open_scenes
    from hybridworldsim.simulator.remote.server import render_server
    from hybridworldsim.simulator.remote.service import Limits, SensorService
    from hybridworldsim.simulator.renderers.registry import RendererFactory, choose_renderer_device
    from hybridworldsim.simulator.street.of_synth import SCHEME
    from hybridworldsim.simulator.street.opening import open_street

    wire()
    is_synth = arguments.source.startswith(SCHEME)
    name = arguments.renderer or ("reconstructed" if arguments.model else "exact" if is_synth else "boxes")
    device = choose_renderer_device(arguments.device, arguments.model, arguments.method)
    if device is not None:
        print(device, flush=True)
    factory = RendererFactory(name, arguments.model, arguments.method, device=CPU if device is None else device.name)
    street = open_street(arguments.source, scene=arguments.scene)
    factory.require_model_of(street)
    scenes = open_scenes(street, factory)
    service = SensorService(scenes, Limits(images_per_s=arguments.rate))
    with render_server(service, arguments.host, arguments.port) as port:
        print(f"{SENSOR_SERVICE} at {arguments.host}:{port}; scenes: {', '.join(sorted(scenes))}", flush=True)
        print("Ctrl-C ends it", flush=True)
        while True:
            time.sleep(3600.0)
