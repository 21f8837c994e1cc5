"""Released models of OpenDWM on the command line: small configurations through the same code, against references."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from scipy.spatial.transform import Rotation

from hybridworldsim.generation.autoencoder.codec import to_tensor
from hybridworldsim.generation.autoencoder.of_diffusers import load_autoencoder
from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.clips.captions import TextEmbedding
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.conditions import frame_conditions
from hybridworldsim.generation.command import main
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, roll_out_clip
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.layout.boxes import OPENDWM_STYLE
from hybridworldsim.generation.layout.images import draw_layout
from hybridworldsim.generation.model_files import read_generator, trained_rates, write_generator
from hybridworldsim.generation.network import configuration
from hybridworldsim.generation.network.checkpoints import load_transformer
from hybridworldsim.generation.network.configuration import BASES
from hybridworldsim.generation.sampling.sampler import draw_noise
from hybridworldsim.generation.scenes import released as released_module
from hybridworldsim.generation.scenes.backgrounds import open_background
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.plan import plan_scene
from hybridworldsim.generation.scenes.released import RELEASED, open_released, released_model
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from hybridworldsim.generation.scenes.scene_clip import SceneConditions, make_scene_clip
from hybridworldsim.generation.scenes.submission import SubmissionRequest
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.weights.errors import WeightsUnavailableError
from tests.generation.builders import SMALL, SMALL_UNIMLVG, released_checkpoint
from tests.generation.clips import make_clip
from tests.generation.reference import Reference

CAMERAS = ("front_wide", "front_left")
SIZE, T = (16, 32), 3
TEXT, POOLED, WORDS = SMALL.text_channels, SMALL.pooled_channels, 2


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The 1,443 released names, eight channels wide."""
    path = tmp_path_factory.mktemp("weights") / "ctsd.pth"
    released_checkpoint(path, dtype=torch.float32)
    return path


def save_vae(folder: Path, channels: int) -> Path:
    """An `AutoencoderKL` of stride 8 as a released pipeline has it, four channels wide."""
    diffusers = pytest.importorskip("diffusers", reason="diffusers is not installed (extra: generation)")
    torch.manual_seed(0)
    model = diffusers.AutoencoderKL(
        down_block_types=("DownEncoderBlock2D",) * 4, up_block_types=("UpDecoderBlock2D",) * 4,
        block_out_channels=(4,) * 4, norm_num_groups=2, latent_channels=channels, use_quant_conv=False,
        use_post_quant_conv=False, shift_factor=0.0609, scaling_factor=1.5305, layers_per_block=1,
    )  # fmt: skip
    model.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def vae(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_vae(tmp_path_factory.mktemp("pipeline") / "vae", 16)


def caption(clip: Clip, frame: int, view: str) -> TextEmbedding:
    """Another text for each view and frame."""
    generator = torch.Generator().manual_seed(10 * frame + clip.views.index(view))
    return TextEmbedding(
        torch.randn(WORDS, TEXT, generator=generator), torch.randn(POOLED, generator=generator)
    )  # fmt: skip


def wide_clip() -> Clip:
    """Images of 32 x 16 px: two tokens."""
    clip = make_clip()
    images, background = (
        np.pad(one, ((0, 0), (0, 0), (0, 0), (0, 8), (0, 0)), mode="edge") for one in (clip.images, clip.background)
    )
    return replace(clip, images=images, background=background, tracks=None)


@torch.no_grad()
def test_a_generated_frame_is_that_of_the_plain_reference(checkpoint: Path) -> None:
    """One reference, two steps with shift 3, guidance by layout, a text for each view of each frame, no map."""
    torch.manual_seed(0)
    clip, codec = wide_clip(), TinyAutoencoder(TinySettings(channels=16, width=4, halvings=3))
    network = load_transformer(checkpoint, SMALL)
    options = ClipRolloutOptions(SamplerSettings(2, 3.0, 2.0), keep_empty_views=False, seed=5)
    rollout = roll_out_clip(network, codec, clip, OPENDWM_STYLE, 2, 1, options, captions=caption, ring=True)
    ours = next(rollout).latents[0, 0].numpy()

    reference = Reference({name: one.double().numpy() for name, one in network.state_dict().items()}, SMALL.heads)
    texts = [[caption(clip, frame, view) for view in clip.views] for frame in (1, 2)]
    unit = clip.intrinsics / np.array([32.0, 16.0, 1.0])[:, None]
    camera = [reference.camera(clip.rate_hz, unit[v], clip.ego_SE3_camera[v], 2.0) for v in range(2)]
    boxes = [
        draw_layout(clip.boxes.at(frame), clip.intrinsics, clip.ego_SE3_camera, SIZE, OPENDWM_STYLE)
        for frame in (1, 2)
    ]  # fmt: skip
    assert all(one.max() > 0.9 for one in boxes)
    without = np.full((2, 2, 6, *SIZE), 32.0 / 255.0)
    known = without.copy()
    known[:, :, :3] = boxes
    recorded = codec.encode(to_tensor(clip.images[1])).double().numpy()
    latents = draw_noise((1, 1, 2, 16, 2, 4), (5, 2))[0, 0].double().numpy()
    for level, lower in ((1.0, 0.75), (0.75, 0.0)):
        velocity = []
        for layout in (without, known):
            out = reference.run(
                np.stack([recorded, latents]),
                1000.0 * np.array([[0.0, 0.0], [level, level]]),
                np.stack([[one.tokens.double().numpy() for one in row] for row in texts]),
                np.stack([[one.pooled.double().numpy() for one in row] for row in texts]),
                [camera, camera],
                layout,
                np.ones((2, 2), bool),
                np.ones((2, 2), bool),
            )
            velocity.append(out[1])
        latents = latents + (lower - level) * (velocity[0] + 2.0 * (velocity[1] - velocity[0]))
    np.testing.assert_allclose(ours, latents, atol=2e-4 * np.abs(latents).max())


AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of a camera that looks along the vehicle."""


def test_views_attend_to_their_neighbours_as_in_the_released_training() -> None:
    clip = make_clip()
    names = ("front_left", "front", "front_right", "back_right", "back", "back_left")
    images, background = (one[:, [0] * 6] for one in (clip.images, clip.background))
    rig = replace(
        clip, views=names, images=images, background=background, tracks=None, present=clip.present[:, [0] * 6],
        intrinsics=clip.intrinsics[[0] * 6], ego_SE3_camera=clip.ego_SE3_camera[[0] * 6],
    )  # fmt: skip
    config = replace(SMALL, layout=None)
    # The mask of nuScenes in OpenDWM's configuration.
    released = ["110001", "111000", "011100", "001110", "000111", "100011"]
    adjacent = frame_conditions(rig, 0, config, None, ring=True).adjacent
    assert adjacent is not None
    assert ["".join(str(int(one)) for one in row) for row in adjacent[0].tolist()] == released
    # Neighbours are those of the round, in whatever order the views come: a protocol has the names sorted.
    turned = np.stack([rig.ego_SE3_camera[0]] * 6)
    azimuths = np.radians([[55.0], [0.0], [-55.0], [-110.0], [180.0], [110.0]])
    turned[:, :3, :3] = Rotation.from_euler("z", azimuths).as_matrix() @ AHEAD
    for order in (list(range(6)), np.argsort(names).tolist()):
        shuffled = replace(rig, views=tuple(names[row] for row in order), ego_SE3_camera=turned[order])
        found = frame_conditions(shuffled, 0, config, None, ring=True).adjacent
        assert found is not None
        wanted = np.array([[one == "1" for one in row] for row in released])[np.ix_(order, order)]
        np.testing.assert_array_equal(found[0].numpy(), wanted)
    pair = frame_conditions(clip, 0, config, None, ring=True).adjacent
    assert pair is not None and bool(pair.all())
    assert frame_conditions(clip, 0, config, None).adjacent is None


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The names of the command line stand for the small configurations."""
    for name, config in (("ctsd-35", SMALL), ("unimlvg", SMALL_UNIMLVG)):
        monkeypatch.setitem(RELEASED, name, replace(RELEASED[name], config=config))
        monkeypatch.setitem(BASES, name, config)


@pytest.fixture(scope="module")
def backgrounds(tiny_dataset: Dataset, traversal: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("backgrounds")
    for place, frame in enumerate(tiny_dataset.where(traversal=traversal).frames()[: T + 1]):
        for camera in CAMERAS:
            file = folder / camera / f"{frame.timestamp_ns}.png"
            file.parent.mkdir(exist_ok=True)
            assert cv2.imwrite(str(file), np.full((32, 64, 3), 50 + place, np.uint8))
    return folder


@pytest.fixture(scope="module")
def captions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A text for the first camera, another for all others."""
    path = tmp_path_factory.mktemp("captions") / "text.safetensors"
    tensors = {}
    for seed, name in enumerate((CAMERAS[0], "all")):
        generator = torch.Generator().manual_seed(seed)
        tensors[f"{name}/tokens"] = torch.randn(WORDS, TEXT, generator=generator)
        tensors[f"{name}/pooled"] = torch.randn(POOLED, generator=generator)
    save_file(tensors, path)
    return path


def words(dataset: Dataset, traversal: str, model: Path, backgrounds: Path, out: Path, *more: object) -> list[str]:
    begin = ["scene", str(dataset.root), str(model), "--background", f"files:{backgrounds}", "--size", "32x16"]
    begin += ["--traversal", traversal, "--cameras", ",".join(CAMERAS), "--frames", "1", "--steps", "2"]
    return [*begin, "--no-keep-empty-views", "--blend", "none", "--out", str(out), *map(str, more)]


def test_a_released_model_generates_a_scene_on_the_command_line(
    small: None,
    tiny_dataset: Dataset,
    traversal: str,
    checkpoint: Path,
    vae: Path,
    backgrounds: Path,
    captions: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The images of the same rollout through the functions, with embeddings made by hand."""
    given = words(tiny_dataset, traversal, checkpoint, backgrounds, tmp_path / "out", "--base", "ctsd-35")
    assert main([*given, "--vae", str(vae), "--captions", str(captions)]) == ExitCode.DONE
    assert "the released weights have no background adapter" in capsys.readouterr().out
    found = [cv2.imread(str(tmp_path / "out" / "frames" / camera / "00000.png"))[..., ::-1] for camera in CAMERAS]
    inputs = json.loads((tmp_path / "out" / "generated.json").read_text())["inputs"]
    assert inputs["base"] == "ctsd-35" and len(inputs["captions"]) == 64
    assert "steps=2, shift=3.0, guidance=4.0" in inputs["rollout"]

    plan = plan_scene(tiny_dataset, traversal, hz=None, trajectory=None, references=T, count=1)
    rig = rig_of(tiny_dataset.where(traversal=traversal).frames(), CAMERAS, SIZE, PIXELS)
    background, _ = open_background(f"files:{backgrounds}", tiny_dataset, "nearest", [])
    scene = SceneConditions(rig, background, plan.rate_hz, plan.light, plan.weather, plan.tracks)
    clip = make_scene_clip("by hand", plan.frames, scene, recorded=T)

    def by_hand(clip: Clip, frame: int, view: str) -> TextEmbedding:
        generator = torch.Generator().manual_seed(CAMERAS.index(view))
        tokens = torch.randn(WORDS, TEXT, generator=generator)
        return TextEmbedding(tokens, torch.randn(POOLED, generator=generator))

    network, codec = load_transformer(checkpoint, SMALL).requires_grad_(False), load_autoencoder(vae)
    options = ClipRolloutOptions(SamplerSettings(2, 3.0, 4.0), keep_empty_views=False)
    images = [
        next(roll_out_clip(network, codec, clip, OPENDWM_STYLE, T, T, options, captions=text, ring=True)).images
        for text in (by_hand, None)
    ]
    # Sums in another order may round to another grey level.
    difference = np.abs(np.stack(found).astype(int) - images[0])
    assert difference.max() <= 1 and (difference > 0).mean() < 0.01
    assert all(np.abs(one.astype(int) - other).max() > 2 for one, other in zip(*images))


def test_captions_of_a_generator_trained_here(
    tiny_dataset: Dataset, traversal: str, models: Path, tmp_path: Path, backgrounds: Path
) -> None:
    trained = models / "generator" / "model.safetensors"
    texts = {"all/tokens": torch.randn(3, 8), "all/pooled": torch.randn(8)}
    save_file(texts, tmp_path / "text.safetensors")
    given = ["--captions", tmp_path / "text.safetensors", "--autoencoder", models / "autoencoder/model.safetensors"]
    with pytest.raises(UsageError, match="trained without text") as caught:
        main(words(tiny_dataset, traversal, trained, backgrounds, tmp_path / "out", *given))
    assert (caught.value.file, caught.value.place) == (str(trained), "--captions")
    write_generator(tmp_path / "model.safetensors", *read_generator(trained), captions=True)
    read_only_one = {f"{CAMERAS[1]}/{name[4:]}": one for name, one in texts.items()}
    save_file(read_only_one, tmp_path / "text.safetensors")
    with pytest.raises(UsageError, match=f"--captions: no caption for {CAMERAS[0]}; expected"):
        main(words(tiny_dataset, traversal, tmp_path / "model.safetensors", backgrounds, tmp_path / "out", *given))
    assert not (tmp_path / "out").exists()


def test_runs_without_captions_keep_their_documents(models: Path, tmp_path: Path) -> None:
    """A hash over a model or a run that was made before captions existed still holds."""
    settings = json.loads((models / "generator" / "run.json").read_text())["settings"]
    assert "captions" not in settings
    trained = models / "generator" / "model.safetensors"
    network, references = read_generator(trained)
    rates_hz = trained_rates(trained)
    write_generator(tmp_path / "again.safetensors", network, references, drop_layout=0.5, rates_hz=rates_hz)
    assert (tmp_path / "again.safetensors").read_bytes() == trained.read_bytes()
    assert b"captions" not in (tmp_path / "again.safetensors").read_bytes()


def test_checkpoints_autoencoders_and_sizes_that_do_not_fit_are_named(
    small: None, checkpoint: Path, vae: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    released_checkpoint(tmp_path / "unimlvg.pth", "unimlvg", torch.float32)
    ctsd, unimlvg = released_model("ctsd-35"), released_model("unimlvg")
    with pytest.raises(WeightsUnavailableError, match=r"load it as unimlvg \(--base unimlvg\)"):
        open_released(ctsd, tmp_path / "unimlvg.pth", vae, SIZE)
    opened = open_released(unimlvg, tmp_path / "unimlvg.pth", vae, SIZE)
    assert (opened.references, opened.style.dropped, opened.ring) == (3, 0.0, True)
    assert not any(one.requires_grad for one in opened.network.parameters())
    with pytest.raises(UsageError, match=r"--size: .*40 x 16 px"):
        open_released(ctsd, checkpoint, vae, (16, 40))
    other = save_vae(tmp_path / "vae", 4)
    with pytest.raises(DatasetError, match="--vae: ") as caught:
        open_released(ctsd, checkpoint, other, SIZE)
    assert caught.value.file == str(other)
    with pytest.raises(WeightsUnavailableError, match="no such file"):
        open_released(ctsd, tmp_path / "nowhere.pth", vae, SIZE)
    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(UsageError, match="need diffusers") as missing:
        open_released(ctsd, checkpoint, vae, SIZE)
    assert "[generation]" in str(missing.value.remedy)


def test_options_that_do_not_go_together_are_named(
    small: None,
    tiny_dataset: Dataset,
    traversal: str,
    checkpoint: Path,
    vae: Path,
    backgrounds: Path,
    captions: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(message: str, *more: object) -> None:
        with pytest.raises((UsageError, DatasetError, WeightsUnavailableError), match=message):
            main(words(tiny_dataset, traversal, checkpoint, backgrounds, tmp_path / "out", *more))
        assert not (tmp_path / "out").exists()

    refused("--vae: an autoencoder of a released model; expected --base", "--vae", vae)
    refused("--vae: no autoencoder", "--base", "ctsd-35")
    refused("--base: no base 'sora'; expected one of ctsd-35, unimlvg", "--base", "sora", "--vae", vae)
    refused("--autoencoder: a released model", "--base", "ctsd-35", "--vae", vae, "--autoencoder", checkpoint)
    wrong = tmp_path / "wrong.safetensors"
    save_file({"all/tokens": torch.zeros(2, TEXT + 1), "all/pooled": torch.zeros(POOLED)}, wrong)
    refused(r"tokens \(2, 7\)", "--base", "ctsd-35", "--vae", vae, "--captions", wrong)
    monkeypatch.setattr(released_module, "load_transformer", lambda *_, **__: torch.empty(1 << 60))
    refused("cpu: the device has too little memory; .* a smaller --size", "--base", "ctsd-35", "--vae", vae)


def test_a_submission_names_the_released_model() -> None:
    own = SubmissionRequest(GeneratorFiles(Path("a"), Path("b")), "generation", "novel", "exact:tiny")
    assert own.method.name == "hybridworldsim-generation"
    method = replace(own, files=replace(own.files, base=released_model("unimlvg"))).method
    assert (method.name, method.licence) == ("hybridworldsim-unimlvg", "MIT")
    assert "nuScenes" in method.trained_on
    assert {name: model.config for name, model in RELEASED.items()} == configuration.BASES
