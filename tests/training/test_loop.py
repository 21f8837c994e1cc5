"""The training loop: its files, its interruption, and exact resumption."""

from __future__ import annotations

import math
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.initialization import initial_street
from hybridworldsim.model.storage import save_block
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.trainable.method import StepReport
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.training.block_training import Options
from hybridworldsim.training.documents import read_run
from hybridworldsim.training.parameters import read_parameters, set_parameters, write_parameters
from hybridworldsim.training.previews import Preview
from hybridworldsim.training.run.budget import Clock
from hybridworldsim.training.run.checkpoint import FORMAT, read_checkpoint
from hybridworldsim.training.run.curves import read_curves
from hybridworldsim.training.run.document import is_occupied
from hybridworldsim.training.run.loop import REPORTS
from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.schema.files import TEMPORARY
from tests.interruption import interrupt_at_call, kill_before
from tests.training.short_run import RUN, block_folder, run
from tests.training.street import SETTINGS, Painted, initial, trainer, view, views


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def test_training_improves_psnr_and_writes_a_complete_folder(tmp_path: Path) -> None:
    one = view("s.day.0", 2)
    preview = Preview("training-0", Painted()(one), Painted()(one).viewpoint.source)
    done = run(tmp_path / "run", 120, options=Options(previews=[preview]))
    rows = read_curves(tmp_path / "run" / "curves.csv", 1000)
    assert done.steps == 120 and done.skipped == 0 and len(rows) == REPORTS
    assert rows[-1]["psnr_db"] > rows[0]["psnr_db"] + 3.0 and done.psnr_db == pytest.approx(rows[-1]["psnr_db"])
    assert {"step", "progress", "core_s", "wall_s", "gaussians", "rgb", "depth", "normal"} <= {*rows[0], *rows[1]}
    assert [row["step"] for row in rows] == [3.0 * (row + 1) for row in range(REPORTS)]
    assert len(list((tmp_path / "run" / "pictures").iterdir())) == 4
    assert (tmp_path / "run" / "curves.svg").read_text().startswith("<svg")
    assert (tmp_path / "run" / "model.safetensors").stat().st_size == done.model_bytes
    assert not list((tmp_path / "run").glob(".*"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StreetTrainer]:
    """The folder of a run that nobody disturbs, and its trainer."""
    folder, trained = tmp_path_factory.mktemp("whole") / "run", trainer()
    run(folder, trainer=trained)
    return folder, trained


@pytest.fixture
def finished(whole: tuple[Path, StreetTrainer], tmp_path: Path) -> Path:
    """A copy of the folder."""
    return Path(shutil.copytree(whole[0], tmp_path / "run"))


def test_stored_model_renders_as_the_trainer(whole: tuple[Path, StreetTrainer]) -> None:
    folder, trained = whole
    fresh = initial_street(replace_points(), SETTINGS)
    set_parameters(fresh, read_parameters(folder / "model.safetensors"))
    viewpoint = Painted()(view("s.night.0", 3)).viewpoint
    with torch.no_grad():
        drawn = fresh(viewpoint, fresh.appearance(viewpoint.source))
    assert torch.equal(drawn.rgb, trained.render(viewpoint).rgb)


def replace_points():
    """A street of other points, whose parameters are all replaced by stored ones."""
    return replace(initial(), points_m=initial().points_m[:7])


def test_half_precision_halves_tables_and_hardly_changes_renders(
    whole: tuple[Path, StreetTrainer], tmp_path: Path
) -> None:
    folder, trained = whole
    half = run(tmp_path / "half", half=True)
    tables = ("offsets", "codes", "log_scales", "quats", "logits")
    numbers = sum(table.numel() for name, table in trained.street.named_parameters() if name.endswith(tables))
    # The header's offsets differ in their number of digits.
    assert (folder / "model.safetensors").stat().st_size - half.model_bytes == pytest.approx(2 * numbers, abs=100)
    fresh = initial_street(initial(), SETTINGS)
    set_parameters(fresh, read_parameters(tmp_path / "half" / "model.safetensors"))
    viewpoint = Painted()(view("s.day.0", 3)).viewpoint
    with torch.no_grad():
        drawn = fresh(viewpoint, fresh.appearance(viewpoint.source))
    assert (drawn.rgb - trained.render(viewpoint).rgb).abs().max() < 0.02


def test_half_precision_keeps_networks_and_image_tables_exact(tmp_path: Path) -> None:
    model = nn.Module()
    model.means, model.codes = nn.Parameter(torch.randn(7, 3)), nn.Parameter(torch.randn(7, 4))
    model.keys, model.out = nn.Parameter(torch.randn(5, 17)), nn.Linear(4, 6)
    write_parameters(tmp_path / "half", model, half=True)
    back = read_parameters(tmp_path / "half")
    assert [name for name, table in back.items() if table.dtype == torch.float16] == ["codes"]
    assert torch.equal(back["keys"], model.keys) and torch.equal(back["means"], model.means)
    torch.testing.assert_close(back["codes"].float(), model.codes.detach(), rtol=1e-3, atol=1e-4)


def test_temporary_files_of_a_killed_process_are_ignored(tmp_path: Path) -> None:
    left = tmp_path / f".run.json.7{TEMPORARY}"
    left.touch()
    assert not is_occupied(tmp_path) and not is_occupied(tmp_path / "new") and is_occupied(left)
    folder = block_folder(tmp_path)
    assert folder.begin(RUN) is None and left.exists() and is_occupied(tmp_path)
    with folder.claim(RUN):
        assert not left.exists() and (tmp_path / "run.json").exists()


def test_lock_refusal_keeps_files_of_the_other_process(tmp_path: Path) -> None:
    run(tmp_path, steps=2)
    folder, writing = block_folder(tmp_path), tmp_path / f".checkpoint.safetensors.7{TEMPORARY}"
    with folder.claim(RUN):
        writing.touch()
        with pytest.raises(DatasetError, match="another process is training"), block_folder(tmp_path).claim(RUN):
            pass
        assert writing.exists()


def test_incomplete_checkpoint_is_refused(tmp_path: Path) -> None:
    trained = trainer()
    run(tmp_path, steps=2, trainer=trained)

    class Older(type(trained)):
        def restore(self, state):
            super().restore({name: table for name, table in state.items() if name != "progress"})

    with pytest.raises(DatasetError, match="without 'progress'"):
        block_folder(tmp_path).resume(Older(trained.street, SETTINGS))


def test_equal_streets_have_equal_bytes(tmp_path: Path) -> None:
    block, street = Block((0, 0), (1.0, 2.0, 3.0)), trainer().street
    for number in range(5):
        save_block(tmp_path / f"{number}.safetensors", block, street)
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1


def train_with_checkpoints(folder: str, threads: str) -> None:
    torch.set_num_threads(int(threads))
    run(Path(folder), 40, options=Options(checkpoint_s=0.05))


@pytest.mark.parametrize("threads", [1, 2])
def test_killed_and_resumed_training_gives_the_same_model(tmp_path: Path, threads: int) -> None:
    torch.set_num_threads(threads)
    kill_before("checkpoint.safetensors", 2, train_with_checkpoints, tmp_path / "killed", str(threads))
    assert (tmp_path / "killed" / "checkpoint.safetensors").exists()
    assert not (tmp_path / "killed" / "outcome.json").exists()
    run(tmp_path / "killed", 40)
    run(tmp_path / "whole", 40)
    ours, theirs = (load_file(tmp_path / name / "checkpoint.safetensors") for name in ("killed", "whole"))
    assert ours.keys() == theirs.keys() and all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert (tmp_path / "killed" / "model.safetensors").read_bytes() == (
        tmp_path / "whole" / "model.safetensors"
    ).read_bytes()
    # The curves equal those of one run, except for times.
    rows = [read_curves(tmp_path / name / "curves.csv", 1000) for name in ("killed", "whole")]
    assert [(row["step"], row["psnr_db"], row["gaussians"]) for row in rows[0]] == [
        (row["step"], row["psnr_db"], row["gaussians"]) for row in rows[1]
    ]


def test_ctrl_c_leaves_a_checkpoint_between_steps(whole: tuple[Path, StreetTrainer], tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "run", images=stopping_at(25))
    assert signal.getsignal(signal.SIGINT) is before
    run(tmp_path / "run")
    assert (tmp_path / "run" / "model.safetensors").read_bytes() == (whole[0] / "model.safetensors").read_bytes()


def test_finished_run_is_returned_and_another_is_refused(finished: Path, tmp_path: Path) -> None:
    folder = block_folder(finished)
    assert folder.begin(RUN) == folder.outcome is not None
    with pytest.raises(UsageError, match=r"settings\.latent 16, now 8; steps 60, now 90"):
        folder.begin(RUN.model_copy(update={"steps": 90, "settings": {"latent": 8}}))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(UsageError, match="not the folder of a run"):
        block_folder(tmp_path / "other").begin(RUN)


def test_lock_allows_one_process(tmp_path: Path) -> None:
    folder = block_folder(tmp_path / "run")
    folder.begin(RUN)
    other = block_folder(tmp_path / "run")
    with folder.claim(RUN), pytest.raises(DatasetError, match="another process"), other.claim(RUN):
        pass
    with folder.claim(RUN):
        pass


def test_broken_checkpoint_is_named_in_the_error(finished: Path) -> None:
    path = finished / "checkpoint.safetensors"
    state = {name: table.clone() for name, table in load_file(path).items()}
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DatasetError, match=r"checkpoint\.safetensors"):
        run(finished)
    for position in ("", "[" * 50_000, "[]", '{"steps": "many"}', '{"sums": {"losses": {"rgb": 1}}}'):
        save_file(state, path, {"format": FORMAT, "position": position})
        with pytest.raises(SchemaError, match=r"checkpoint\.safetensors"):
            read_checkpoint(path)


def edited(**changes):
    return Painted(lambda image: replace(image, **{name: make(image) for name, make in changes.items()}))


@pytest.mark.parametrize(
    ("field", "make"),
    [
        ("rgb", lambda p: p.rgb.index_fill(0, torch.tensor([3]), torch.nan)),
        ("depth_m", lambda p: p.depth_m.index_fill(0, torch.tensor([3]), torch.inf)),
        (
            "viewpoint",
            lambda p: replace(p.viewpoint, viewmat=p.viewpoint.viewmat.index_fill(0, torch.tensor([1]), torch.nan)),
        ),
    ],
)
def test_images_that_are_not_finite_are_refused_and_the_checkpoint_stays(tmp_path: Path, field: str, make) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "run", images=stopping_at(20))
    before = (tmp_path / "run" / "checkpoint.safetensors").read_bytes()
    with pytest.raises(DatasetError, match=r"renders/training/.*finite"):
        run(tmp_path / "run", images=edited(**{field: make}))
    assert (tmp_path / "run" / "checkpoint.safetensors").read_bytes() == before


def stopping_at(count: int) -> Painted:
    return Painted(interrupt_at_call(lambda image: image, count + 1))


def test_loss_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    class Diverging(StreetTrainer):
        def step(self, image, progress):
            return StepReport({"rgb": 0.1, "depth": torch.inf}, 1)

    with pytest.raises(DatasetError, match="loss depth is inf at step 0"):
        run(tmp_path / "run", trainer=Diverging(trainer().street, SETTINGS))
    assert not (tmp_path / "run" / "checkpoint.safetensors").exists()


def test_parameters_that_are_not_finite_are_not_checkpointed(tmp_path: Path) -> None:
    # Such Gaussians are culled, so that the losses stay finite.
    broken = trainer()
    with torch.no_grad():
        broken.street.appearance.drives[0, 0] = torch.nan
    with pytest.raises(DatasetError, match=r"not finite at step [12]"):
        run(tmp_path / "run", trainer=broken)
    assert not (tmp_path / "run" / "checkpoint.safetensors").exists()


def black(image: TrainingImage) -> TrainingImage:
    return replace(image, rgb=torch.zeros_like(image.rgb)) if image.rgb.max() < 0.31 else image


@pytest.mark.parametrize(
    ("images", "chosen"),
    [
        pytest.param(Painted(black), views(), id="a black traversal"),
        pytest.param(edited(rgb=lambda p: torch.full_like(p.rgb, 0.5)), views(), id="constant images"),
        pytest.param(edited(rgb=lambda p: torch.ones_like(p.rgb)), views(), id="saturated images"),
        pytest.param(edited(depth_m=lambda p: None), views(), id="no depth"),
        pytest.param(edited(depth_m=lambda p: torch.zeros_like(p.depth_m)), views(), id="unknown depth"),
        pytest.param(Painted(), [view("s.day.0", 1)], id="one image"),
        pytest.param(Painted(), [view("s.day.0", 1)] * 8, id="duplicated images"),
        pytest.param(
            Painted(),
            [*views(traversals=("s.day.0",)), *(view("s.night.0", n, x_m=-500.0 * n) for n in range(6))],
            id="a traversal with wrong poses",
        ),
        pytest.param(
            edited(scored=lambda p: p.scored & (torch.arange(20)[:, None] > 18) & (torch.arange(32) > 30)),
            views(),
            id="one pixel",
        ),
    ],
)
def test_training_survives_unusual_images(tmp_path: Path, images: Painted, chosen) -> None:
    done = run(tmp_path / "run", 40, images=images, views=chosen)
    assert done.steps == 40 and done.psnr_db > 5.0
    assert all(table.isfinite().all() for table in load_file(tmp_path / "run" / "model.safetensors").values())


def test_masked_pixels_do_not_affect_the_model(tmp_path: Path) -> None:
    """Neither colours nor depths of road users and of the vehicle itself affect the model."""
    covered = torch.zeros(20, 32, dtype=torch.bool)
    covered[12:, 8:24] = True
    plain = edited(scored=lambda p: p.scored & ~covered)

    def painted(image: TrainingImage) -> TrainingImage:
        own = plain.edit(image)
        rgb = torch.where(covered[..., None], torch.tensor([1.0, 0.0, 1.0]), own.rgb)
        return replace(own, rgb=rgb, depth_m=torch.where(covered, 2.0, own.depth_m))

    models = {}
    for name, images in (("plain", plain), ("painted", Painted(painted)), ("unmasked", Painted())):
        run(tmp_path / name, 20, images=images)
        models[name] = (tmp_path / name / "model.safetensors").read_bytes()
    assert models["plain"] == models["painted"] != models["unmasked"]


def test_depth_counts_where_the_render_is_mostly_opaque() -> None:
    """The depth of a nearly transparent pixel is a quotient of two small numbers."""
    trained, image = trainer(), Painted()(view("s.day.0", 1))
    for gone, network_inputs in ((0.0, True), (9.0, False)):
        with torch.no_grad():
            for node in (trained.street.ground, trained.street.sky):
                node.logits -= gone
            trained.street.background.geometry.out.bias.view(-1, 8)[:, 0] -= gone
        alpha = trained.render(image.viewpoint).alpha
        report = trained.step(image, 0.0)
        known = (image.depth_m > 0.0) & (alpha > 0.5)
        assert bool(known.any()) == network_inputs and (report.losses["depth"] > 0.0) == network_inputs


def test_images_without_scored_pixels_are_counted_and_skipped(tmp_path: Path) -> None:
    masked = edited(scored=lambda p: p.scored & (p.rgb.max() > 0.31))
    done = run(tmp_path / "run", images=masked)
    assert done.steps == 60 and 50 <= done.skipped <= 70


def test_masks_over_everything_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="masks cover every training image"):
        run(tmp_path / "run", images=edited(scored=lambda p: torch.zeros_like(p.scored)))


def test_budget_excludes_kernel_compilation(tmp_path: Path) -> None:
    """Compilation happens once on a machine, and could use up a short budget."""

    @numba.njit
    def kernel(values):
        total = 0.0
        for value in np.sort(values):
            total += np.sin(value) * math.exp(-value)
        return total

    clock, begin = Clock(), time.process_time()
    kernel(np.ones(3))
    compiled_s = time.process_time() - begin
    assert compiled_s > 0.2 and clock.spent_s < 0.3 * compiled_s
    before = clock.spent_s
    while time.process_time() - begin < compiled_s + 0.1:
        kernel(np.ones(1000))
    assert clock.spent_s - before == pytest.approx(0.1, abs=0.05)
    clock.pause()
    kernel(np.ones(3, np.float32))
    clock.resume()
    assert clock.spent_s - before < 0.2


def test_untrained_run_may_be_replaced_by_other_settings(tmp_path: Path) -> None:
    """A run that failed before its first checkpoint does not reserve the folder."""
    folder, other = block_folder(tmp_path / "run"), RUN.model_copy(update={"seed": 1})
    folder.begin(other)
    assert folder.begin(RUN) is None
    # The folder keeps the document of the other run until training begins.
    assert read_run(tmp_path / "run") == other
    with folder.claim(RUN):
        pass
    assert read_run(tmp_path / "run") == RUN
    run(tmp_path / "run", 2)
    with pytest.raises(UsageError, match="a run of other settings began here"), folder.claim(other):
        pass
    with pytest.raises(UsageError, match="seed 0, now 1"):
        folder.begin(other)
    (tmp_path / "run" / "outcome.json").unlink()
    with pytest.raises(UsageError, match="seed 0, now 1"):
        folder.begin(other)


@pytest.mark.parametrize(
    ("changes", "losses"),
    [
        ({}, {"rgb", "depth", "normal"}),
        ({"depth_weight": 0.0}, {"rgb", "normal"}),
        ({"normal_weight": 0.0}, {"rgb", "depth"}),
        ({"depth_weight": 0.0, "normal_weight": 0.0}, {"rgb"}),
    ],
)
def test_each_loss_can_be_switched_off(changes, losses: set[str]) -> None:
    trained = trainer(replace(SETTINGS, **changes))
    assert set(trained.step(Painted()(view("s.day.0", 1)), 0.0).losses) == losses
    assert trained.reads_depth == bool(losses - {"rgb"})
