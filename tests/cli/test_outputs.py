"""Every verb refuses an output that cannot be written, before it works, and names the extra of a missing package."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode

COMMANDS = (
    "annotate describe D",
    "annotate export D --boxes a@1",
    "annotate report D --boxes a@1",
    "annotate train D --annotator petr-tiny",
    "baseline D --method nearest_frame --split s",
    "calibrate check D",
    "dataset fetch D",
    "dataset publish D --split s",
    "demo",
    "evaluate D S",
    "export colmap D",
    "export-ply D M",
    "generate clips D --background M",
    "generate distil G C --steps 1",
    "generate scene D G --background M",
    "generate train C --steps 1",
    "ingest R",
    "leaderboard build",
    "plot D",
    "reconstruct D --split s",
    "release build D --name n --licence l --contact c",
    "render D M --split s",
    "render D M --trajectory t",
    "report D",
    "rois propose R",
    "simulate D --scenario cut-in --policy idm",
    "sql D q",
    "submission hidden D --split s --recordings R",
    "submission new D --split s --protocol p",
    "synth",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_an_output_below_a_file_is_refused_before_any_work(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    for out in ("file/out", "file/a/b/out.mp4"):
        # The inputs do not exist: what is refused first is the output.
        try:
            code = main([*command.split(), "--out", out])
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        said = capsys.readouterr().err
        assert code == ExitCode.COULD_NOT_RUN, said
        assert "is a file" in said and out in said and "--out" in said, said


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        ("simulate synth:tiny --scenario cut-in --policy idm --out out", "simulator"),
        ("generate clips dataset --background model --out out", "generation"),
        ("generate train clips --out out", "generation"),
        ("generate scene dataset generator --out out", "generation"),
    ],
)
def test_a_base_install_names_the_missing_extra(command: str, extra: str, tmp_path: Path) -> None:
    hidden = ("torch", "scipy", "safetensors", "diffusers", "gymnasium", "grpc", "av", "matplotlib")
    code = (
        "import sys\n"
        f"for name in {hidden!r}: sys.modules[name] = None\n"
        f"from mirror.cli.main import main; sys.exit(main({command.split()!r}))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == ExitCode.COULD_NOT_RUN, done.stderr
    assert "Traceback" not in done.stderr and f"[{extra}]" in done.stderr, done.stderr
