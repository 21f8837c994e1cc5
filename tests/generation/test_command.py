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


def test_training_prints_where_the_models_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = write_clips(tmp_path / "clips", count=1)
    words = ["train", str(clips), "--steps", "1", "--autoencoder-steps", "1", "--out", str(tmp_path / "out"), "--json"]
    assert main([*words, "--no-background", "--batch", "1"]) == ExitCode.DONE
    printed = json.loads(capsys.readouterr().out)
    network, references = read_generator(Path(printed["generator"]))
    assert network.config.background is None
    assert (network.config.layout, references, printed["steps"]) == (TINY.layout, 5, 1)
    outcome = json.loads((tmp_path / "out/autoencoder/outcome.json").read_text())
    assert printed["autoencoder_psnr_db"] == outcome["psnr_db"] > 3.0
    with pytest.raises(UsageError, match="a run of other settings began here"):
        main([*words, "--batch", "1"])
    # The same again is done already; the bound is said in words too, by one of several processes.
    assert main([*words[:-1], "--no-background", "--batch", "1"]) == ExitCode.DONE
    assert (
        f"{outcome['psnr_db']:.2f} dB on its training images, which bounds what is generated" in capsys.readouterr().out
    )
    monkeypatch.setenv("RANK", "1")
    assert main([*words, "--no-background", "--batch", "1"]) == ExitCode.DONE
    assert capsys.readouterr().out == ""


def test_a_folder_without_clips_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no clips\.json"):
        main(["train", str(tmp_path), "--steps", "1", "--out", str(tmp_path / "out")])
    for option, words in (
        ("--steps", "--steps: 0 steps"),
        ("--autoencoder-steps", "--autoencoder-steps: 0 autoencoder steps"),
        ("--threads", "--threads: 0 threads"),
        ("--seed", "--seed: seed -1"),
    ):
        given = ["--steps", "1", option, "-1" if option == "--seed" else "0"]
        with pytest.raises(UsageError, match=words):
            main(["train", str(tmp_path), *given, "--out", str(tmp_path / "out")])
    with pytest.raises(UsageError, match="a batch of 4 in 3 parts"):
        main(["train", str(tmp_path), "--steps", "1", "--accumulate", "3", "--out", str(tmp_path / "out")])
    with pytest.raises(UsageError, match="--learning-rate: nan"):
        main(["train", str(tmp_path), "--steps", "1", "--learning-rate", "nan", "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()
