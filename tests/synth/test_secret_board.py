"""A board of a street with a secret seed: nothing that is published has the seed, and the organiser can score."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import mirror.synth
from mirror.cli.main import main
from mirror.protocols.truth.hidden import HIDDEN
from mirror.synth import PRESETS
from mirror.synth.fleet.drives import make_drives
from mirror.synth.seeds import draw_secret_seed, pack_secret_seed
from mirror.synth.writing.secret import SECRET, read_secret, write_secret
from tests.evaluation.submissions import small_text
from tests.interruption import InterruptingProgress
from tests.synth.secrets import find_secrets, spellings

DRIVES = ("guangzhou-urban-01", "guangzhou-urban-02")
LANES = 'name = "novel"\nroles = ["held_out"]'


@dataclass(frozen=True)
class Board:
    """Folders of an organiser, and what the commands printed.

    Attributes:
        here: folder of all.
        seed: the secret seed.
        printed: everything that the commands printed.
    """

    here: Path
    seed: int
    printed: str

    @property
    def secrets(self) -> dict[str, int]:
        """The secret seed and all that are derived from it."""
        _, drives = make_drives("tiny", self.seed)
        named = {"seed": self.seed}
        for drive in drives:
            named |= {
                "world": drive.world_seed,
                drive.drive_id: drive.seed,
                drive.vehicle.vehicle_id: drive.vehicle.seed,
            }
        return named


@pytest.fixture(scope="module", autouse=True)
def _fewer_images() -> Iterator[None]:
    """The tiny street has half of its images here, and they are smaller."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(PRESETS, "tiny", replace(PRESETS["tiny"], width_px=96, image_hz=0.25))
        yield


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Board:
    """The whole way: recordings, dataset, published part, template, hidden truth, submission, result, row, page."""
    here = tmp_path_factory.mktemp("secret")
    with pytest.raises(KeyboardInterrupt):
        second = InterruptingProgress(0, phases=1)
        mirror.synth.write_recordings(here / "recordings", secret=True, workers=2, progress=second)
    seed = read_secret(here / "recordings")
    shifted = LANES + "\nego_shift_m = 1.0"
    text = small_text(every=12, groups=f"[[groups]]\n{shifted}\n", metrics='[[metrics]]\nmetric = "psnr"\n')
    (here / "lane.toml").write_text(text)
    lane = ["--split", "novel", "--protocol", "lane.toml"]
    commands = [
        ["synth", "--preset", "tiny", "--secret", "--workers", "2", "--json", "--out", "recordings"],
        ["ingest", *(f"recordings/{drive}" for drive in DRIVES), "--rois", "recordings/rois.geojson",
         "--map", "recordings/maps", "--licence", "CC0-1.0", "--out", "full"],
        ["split", "full", "novel", "--train", "1", "--held-out-traversals", "1"],
        ["dataset", "publish", "full", "--split", "novel", "--name", "street", "--out", "published"],
        ["submission", "new", "full", *lane, "--out", "template"],
        ["submission", "hidden", "full", *lane, "--recordings", "recordings", "--json", "--out", "hidden"],
        ["baseline", "published", "--method", "mean_color", "--split", "novel", "--out", "submission"],
        ["evaluate", "full", "submission", "--workers", "1", "--out", "results", "--report"],
        ["leaderboard", "key", "--out", "key"],
        ["leaderboard", "add", "results/result.json", "full", "--dataset-name", "street", "--submission", "submission",
         "--workers", "1", "--board", "board"],
        ["leaderboard", "sign", "--key", "key", "--board", "board"],
        ["leaderboard", "build", "--board", "board", "--out", "site"],
    ]  # fmt: skip
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, redirect_stdout(printed), redirect_stderr(printed):
        patched.chdir(here)
        for words in commands:
            assert main(words) == 0, (words, printed.getvalue())
    assert read_secret(here / "recordings") == seed
    return Board(here, seed, printed.getvalue())


def test_the_search_finds_planted_secrets(board: Board, tmp_path: Path) -> None:
    """The search would find each spelling in each kind of file."""
    for number, text in enumerate(spellings(board.seed).values()):
        (tmp_path / f"{number}.bin").write_bytes(b"ab" + text + b"cd")
    pq.write_table(pa.table({"x": [str(board.seed)], "y": ["a"]}), tmp_path / "table.parquet", compression="zstd")
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.txt", pack_secret_seed(board.seed) * 20)
    (tmp_path / f"name-{board.seed}").write_bytes(b"")
    found = {line.split(":")[0] for line in find_secrets(tmp_path, {"seed": board.seed})}
    assert found == {path.name for path in tmp_path.iterdir()}


def test_nothing_but_the_secret_file_has_the_seed(board: Board) -> None:
    """Recordings, dataset, bundle, template, hidden truth, renders, results, entries and page are searched."""
    found = {line.split(":")[0] for line in find_secrets(board.here, board.secrets)}
    assert found == {f"recordings/{SECRET}"}
    assert json.loads((board.here / "hidden" / HIDDEN).read_text())["seed"] is None
    assert not [text for secret in board.secrets.values() for text in spellings(secret).values()
                if text.decode("latin-1") in board.printed]  # fmt: skip
    assert not [path for path in board.here.rglob(f"*{SECRET}*") if path.parent.name != "recordings"]


def test_the_organiser_alone_can_render_the_truth(
    board: Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert list((board.here / "hidden" / "renders").rglob("*.png"))
    shutil.copytree(board.here / "recordings", tmp_path / "recordings", ignore=shutil.ignore_patterns(SECRET, "images"))
    words = ["submission", "hidden", str(board.here / "full"), "--split", "novel", "--protocol",
             str(board.here / "lane.toml"), "--out", str(tmp_path / "out")]  # fmt: skip
    assert main([*words, "--recordings", str(tmp_path / "recordings")]) == 2
    assert SECRET in capsys.readouterr().err
    # Recordings are not continued with another seed.
    synth = ["synth", "--preset", "tiny", "--out", str(tmp_path / "recordings")]
    assert main([*synth, "--secret"]) == 2
    assert SECRET in capsys.readouterr().err
    assert main(synth) == 2
    assert "--seed or --secret" in capsys.readouterr().err
    # A guessed seed is refused by the comparison with a recorded image or by the times of the images.
    write_secret(tmp_path / "recordings", draw_secret_seed())
    assert main([*words, "--recordings", str(tmp_path / "recordings")]) == 2
    said = capsys.readouterr().err
    assert "its secret seed" in said and str(read_secret(tmp_path / "recordings")) not in said
