"""The request of a single drive of ``mirror simulate``, made from its command line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory, choose_renderer_device
from hybridworldsim.simulator.rollout.actions import Repeat
from hybridworldsim.simulator.rollout.earlier_drive import EarlierDrive
from hybridworldsim.simulator.rollout.run import RolloutRequest
from hybridworldsim.simulator.rollout.same_street import require_same_street
from hybridworldsim.simulator.street.opening import open_street
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.schema.rollout import SCENARIO_FILE
from mirror.schema.scenario import Scenario, read_scenario, scenario_file

if TYPE_CHECKING:
    from hybridworldsim.simulator.arguments import Arguments
    from hybridworldsim.simulator.ego.vehicle import Controls
    from hybridworldsim.simulator.policies.protocol import Policy
    from hybridworldsim.simulator.renderers.generated import DriveGenerator

_SYNTH: Final = "synth:"


def make_request(arguments: Arguments) -> RolloutRequest:
    """Return the request of the command line: street, scenario, policy, cameras and renderer.

    Raises:
        UsageError: an option is missing, out of its range, or does not go with another one or an earlier rollout.
        DatasetError, SchemaError: a file that an option names cannot be read.
    """
    if arguments.source is None:
        raise UsageError("no street", place="DATASET", expected="a dataset, synth:PRESET, or --suite NAME")
    for option, seconds in (("--deadline", arguments.deadline), ("--duration", arguments.duration)):
        if seconds is not None and not 0.0 < seconds <= 3600.0:
            raise UsageError(f"{seconds:g} s", place=option, expected="a number of seconds above 0, at most 3600")
    is_synth = arguments.source.startswith(_SYNTH)
    if (Path(arguments.source) / "reconstruction.json").is_file():
        raise UsageError(
            "a model has no rig and no recordings", file=arguments.source, place="DATASET",
            expected="the dataset that it was trained on", remedy="name both: mirror simulate DATASET MODEL",
        )  # fmt: skip
    if arguments.model is not None and not (arguments.model / "reconstruction.json").is_file():
        raise UsageError(
            "no model here", file=arguments.model, place="MODEL", expected="a folder that `mirror reconstruct` wrote"
        )
    plain_name = "reconstructed" if arguments.model else "exact" if is_synth else "boxes"
    name = arguments.renderer or ("generated" if arguments.generator else plain_name)
    device = choose_renderer_device(arguments.device, arguments.model, arguments.method)
    if device is not None and not arguments.json:
        print(device, flush=True)
    generator = _generator(arguments)
    device_name = CPU if device is None else device.name
    factory = RendererFactory(name, arguments.model, arguments.method, device=device_name, generator=generator)
    seed, policy_name = arguments.seed, arguments.policy
    option, folder = _earlier(arguments)
    earlier = None if folder is None else EarlierDrive.read(folder)
    if earlier is not None:
        file = str(earlier.folder / SCENARIO_FILE)
        scenario, seed = earlier.scenario, earlier.rollout.seed
        if policy_name is None:
            scenario = earlier.driven_scenario
            policy: Any = Repeat(earlier.controls)
            policy_name = f"replay of {earlier.rollout.policy}"
        else:
            policy = _policy(arguments, policy_name)
    elif arguments.scenario is None or policy_name is None:
        raise UsageError(
            "no scenario, or no policy", place="--scenario, --policy", expected="both of them, or --replay RUN"
        )
    else:
        file = scenario_file(arguments.scenario)
        scenario, policy = read_scenario(arguments.scenario), _policy(arguments, policy_name)
    if generator is not None and earlier is None:
        scenario = generator.at_rate(scenario, arguments.hz)
    if generator is not None and not arguments.json:
        print(generator.describe_rate(scenario), flush=True)
    if arguments.duration is not None:
        if round(arguments.duration * scenario.rate_hz) < 1:
            raise UsageError(
                f"{arguments.duration:g} s", place="--duration",
                expected=f"at least one step of the scenario, {1.0 / scenario.rate_hz:g} s",
            )  # fmt: skip
        plain = {**scenario.model_dump(), "duration_s": arguments.duration}
        scenario = Scenario.model_validate(plain)
    street = open_street(arguments.source, scene=arguments.scene, road_map=arguments.map, boxes=arguments.boxes)
    dataset_hash = _dataset_hash(arguments.source)
    model_hash = None if arguments.model is None else _model_hash(arguments.model, generator)
    controls: Sequence[Controls] = ()
    if earlier is not None:
        require_same_street(earlier.folder, earlier.rollout, street, scenario, dataset_hash, option)
        if arguments.at is not None:
            earlier.require_renderer(name, model_hash)
            controls = earlier.controls_until(arguments.at, scenario)
            policy_name = f"{policy_name} after {arguments.at:g} s of {earlier.rollout.policy}"
    shown = tuple(street.rig) if arguments.cameras is None else tuple(arguments.cameras.split(","))
    unknown = [camera for camera in shown if camera not in street.rig]
    if unknown:
        raise UsageError(
            f"no camera {', '.join(unknown)}", place="--cameras", expected=f"some of {', '.join(street.rig)}"
        )
    unknown = [camera for camera in policy.cameras if camera not in street.rig]
    if unknown:
        raise UsageError(
            f"policy {policy_name} reads the images of {', '.join(unknown)}, which the rig does not have",
            place="--policy", expected=f"cameras of {', '.join(street.rig)}",
            remedy="mend the attribute cameras of the policy",
        )  # fmt: skip
    wanted = dict.fromkeys((*policy.cameras, *(shown if arguments.video else ())))
    return RolloutRequest(
        street=street,
        scenario=scenario,
        policy=policy,
        policy_name=policy_name,
        cameras=rig_cameras(street, tuple(wanted), arguments.width, arguments.height),
        factory=factory,
        seed=seed,
        video=shown if arguments.video else (),
        page=arguments.report,
        scenario_file=file,
        # A remote policy's own calls end at its deadline.
        deadline_s=math.inf if arguments.deadline is None or "://" in policy_name else arguments.deadline,
        dataset_hash=dataset_hash,
        model_hash=model_hash,
        begins_with=controls,
    )


def _earlier(arguments: Arguments) -> tuple[str, Path | None]:
    """Return the option that names an earlier rollout, and its folder; None: there is none."""
    option, folder = ("--replay", arguments.replay) if arguments.begin is None else ("--from", arguments.begin)
    if arguments.begin is None and arguments.at is not None:
        raise UsageError(f"{arguments.at:g} s", place="--at", expected="--from RUN beside it")
    if folder is None:
        return option, None
    given = (arguments.scenario, arguments.seed, arguments.hz)
    if arguments.begin is None:
        if any(one is not None for one in (*given, arguments.policy)):
            raise UsageError(
                "it has its own scenario, controls, seed and rate", place=option,
                expected="neither --scenario nor --policy nor --seed nor --hz",
            )  # fmt: skip
    elif any(one is not None for one in (*given, arguments.replay)):
        raise UsageError(
            "it has its own scenario, seed and rate", place=option,
            expected="neither --scenario nor --seed nor --hz nor --replay",
        )  # fmt: skip
    elif arguments.policy is None or arguments.at is None:
        raise UsageError("no policy, or no instant", place=option, expected="--policy and --at beside it")
    return option, folder


def _generator(arguments: Arguments) -> DriveGenerator | None:
    if arguments.generator is None:
        given = (arguments.fallback is not None, arguments.blend != "4", arguments.hz is not None)
        for option, is_given in zip(("--fallback", "--blend", "--hz"), given):
            if is_given:
                raise UsageError("it concerns generated road users", place=option, expected="--generator beside it")
        return None
    from hybridworldsim.generation.commands.model_paths import find_model_files
    from hybridworldsim.generation.commands.scene import parse_blend
    from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
    from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
    from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
    from hybridworldsim.simulator.renderers.generated import DriveGenerator

    if arguments.sampler_steps < 1:
        raise UsageError(f"{arguments.sampler_steps} steps", place="--sampler-steps", expected="at least 1")
    rollout = ClipRolloutOptions(SamplerSettings(arguments.sampler_steps), blend_px=parse_blend(arguments.blend))
    files = GeneratorFiles(*find_model_files(arguments.generator, None))
    return DriveGenerator(files, rollout, falls_back=arguments.fallback is not None)


def _policy(arguments: Arguments, name: str) -> Policy:
    from hybridworldsim.simulator.policy_registry import make_policy

    if "://" not in name and arguments.driver is None:
        return make_policy(name)
    from hybridworldsim.simulator.remote.driver_file import DriverFile, read_driver_file
    from hybridworldsim.simulator.remote.policy import require_driver

    driver = DriverFile() if arguments.driver is None else read_driver_file(arguments.driver)
    if arguments.deadline is not None:
        driver = driver.model_copy(update={"deadline_s": arguments.deadline})
    policy = make_policy(name, driver)
    require_driver(name)
    return policy


def _dataset_hash(source: str) -> str | None:
    if source.startswith(_SYNTH):
        return None
    import mirror

    return mirror.open(source).index_sha256


def _model_hash(folder: Path, generator: DriveGenerator | None) -> str:
    import hashlib

    digest = hashlib.sha256()
    # The weights of our methods; a method of another package or file may write any file.
    files = sorted(folder.rglob("*.safetensors")) or sorted(path for path in folder.rglob("*") if path.is_file())
    for path in files:
        digest.update(path.relative_to(folder).as_posix().encode())
        digest.update(path.read_bytes())
    if generator is not None:
        digest.update("".join(generator.files.hashes().values()).encode())
    return digest.hexdigest()
