"""The command line of ``mirror generate``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hybridworldsim.generation.command import main
from hybridworldsim.generation.model_files import read_generator
from hybridworldsim.generation.network.configuration import TINY
from mirror.errors import DatasetError, ExitCode, UsageError
from tests.generation.clips import write_clips


def test_training_prints_where_the_models_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clips = write_clips(tmp_path / "clips", count=1)
    words = ["train", str(clips), "--steps", "1", "--autoencoder-steps", "1", "--out", str(tmp_path / "out"), "--json"]
    assert main([*words, "--no-background", "--batch", "1"]) == ExitCode.DONE
    printed = json.loads(capsys.readouterr().out)
    network, references = read_generator(Path(printed["generator"]))
    assert network.config.background is None
    assert (network.config.layout, references, printed["steps"]) == (TINY.layout, 5, 1)
    with pytest.raises(UsageError, match="a run of other settings began here"):
        main([*words, "--batch", "1"])


def test_a_folder_without_clips_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no clips\.json"):
        main(["train", str(tmp_path), "--steps", "1", "--out", str(tmp_path / "out")])
    with pytest.raises(UsageError, match="below 1"):
        main(["train", str(tmp_path), "--steps", "0", "--out", str(tmp_path / "out")])
    with pytest.raises(UsageError, match="a batch of 4 in 3 parts"):
        main(["train", str(tmp_path), "--steps", "1", "--accumulate", "3", "--out", str(tmp_path / "out")])
    with pytest.raises(UsageError, match="learning_rate nan"):
        main(["train", str(tmp_path), "--steps", "1", "--learning-rate", "nan", "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()
