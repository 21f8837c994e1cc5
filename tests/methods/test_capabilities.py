"""What methods can do: stated as data, checked, and shown by the functions of a method without a statement."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode, UsageError
from mirror.methods import Capabilities, open_model
from mirror.methods.capabilities import NEEDED_IF_STATED, NEEDED_OF_METHOD, NEEDED_OF_RENDERER
from mirror.methods.interactive import PlainRenderer, TrainedAppearance
from mirror.methods.model import ModelFolder, read_models
from mirror.methods.registry import METHODS, load_method
from mirror.plugins import list_parts
from tests.conftest import ROOT

EXAMPLE = ROOT / "examples" / "method.py"
STATED = "    capabilities = Capabilities(renders_depth=True)\n"
ALL_FUNCTIONS = """
class Able(MeanColour):
    capabilities = {stated}

    def open_interactive(self, model):
        return "interactive"

    def export_ply(self, model, views, out, options, appearance):
        return "exported"


METHOD = Able()
"""


def make_model(dataset: Dataset, folder: Path, text: str | None = None) -> tuple[Path, str]:
    """A model of the example method, or of the text that is put below it; the method in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    method = folder / "method.py"
    method.write_text(EXAMPLE.read_text() + (text or ""))
    words = ("--split", "novel", "--method", f"{method}:METHOD", "--out", str(folder / "model"))
    assert main(["reconstruct", str(dataset.root), *words]) == ExitCode.DONE
    return folder / "model", f"{method}:METHOD"


def test_every_installed_method_states_what_its_functions_show() -> None:
    for name in METHODS.names():
        method = load_method(name)
        stated = vars(method)["capabilities"]
        assert stated.renders_depth, name
        shown = {one for one, interface in NEEDED_OF_METHOD.items() if not list_parts(interface) - {*dir(method)}}
        assert stated.names & NEEDED_OF_METHOD.keys() == shown, name


def test_a_capability_has_its_function_and_its_row_in_the_documents() -> None:
    named = {field.name for field in fields(Capabilities)}
    without_function = {"rasterizes", "has_headlights", "distributes_blocks"}
    assert named == {*NEEDED_OF_METHOD, *NEEDED_OF_RENDERER, *NEEDED_IF_STATED, *without_function}
    rows = (ROOT / "docs" / "reconstruction" / "methods.md").read_text().split("| capability |")[1].split("\n\n")[0]
    assert all(f"| `{name}` |" in rows for name in named)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ("None", ("open_interactive", "export_ply", "render")),
        ("Capabilities()", ()),
        ("Capabilities(exports_ply=True, renders_depth=True)", ("export_ply", "render")),
    ],
)
def test_a_statement_decides_and_functions_without_one(
    tiny_dataset: Dataset, tmp_path: Path, stated: str, expected: Sequence[str]
) -> None:
    folder, method = make_model(tiny_dataset, tmp_path, ALL_FUNCTIONS.format(stated=stated))
    model = ModelFolder.read(folder, method)
    trained = [TrainedAppearance("a", "day", "clear")]
    opened = model.open_interactive(trained)
    assert isinstance(opened, PlainRenderer) is ("open_interactive" not in expected)
    assert model.open().capabilities.renders_depth is ("render" in expected)
    if "export_ply" in expected:
        assert model.export_ply([], folder, None, None) == "exported"  # type: ignore[arg-type, comparison-overlap]
    else:
        with pytest.raises(UsageError) as refused:
            model.export_ply([], folder, None, None)  # type: ignore[arg-type]
        assert refused.value.file == str(folder)


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        ("Capabilities(exports_ply=True)", "export_ply"),
        ("Capabilities(opens_interactively=True)", "open_interactive"),
        ("('depth',)", "tuple"),
    ],
)
def test_a_stated_capability_without_its_function_is_refused_before_the_work(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], stated: str, named: str
) -> None:
    (tmp_path / "method.py").write_text(EXAMPLE.read_text().replace(STATED, f"    capabilities = {stated}\n"))
    words = ("--split", "novel", "--method", f"{tmp_path / 'method.py'}:METHOD", "--out", str(tmp_path / "model"))
    assert main(["reconstruct", str(tiny_dataset.root), *words]) == ExitCode.COULD_NOT_RUN
    said = capsys.readouterr().err
    assert named in said and "method.py:METHOD" in said
    assert not (tmp_path / "model").exists()


def test_a_renderer_without_the_function_that_its_method_states_is_refused(
    tiny_dataset: Dataset, tmp_path: Path
) -> None:
    text = "\n\nclass Flat(MeanColour):\n    def open(self, model, appearance):\n"
    text += "        return lambda view: None\n\n\nMETHOD = Flat()\n"
    folder, method = make_model(tiny_dataset, tmp_path, text)
    with pytest.raises(UsageError) as refused:
        ModelFolder.read(folder, method).open()
    assert "renders_depth" in str(refused.value) and "method.py:METHOD" in str(refused.value)


OPENING = """
from pathlib import Path

from mirror.methods import RenderView, open_model

view = RenderView.model_validate_json(Path("view.json").read_text())
street = open_model(Path("model"), method="method.py:METHOD")
print(*street(view)[0, 0], float(street.render(view).depth_m[0, 0]))
"""


def test_a_model_opens_from_its_folder_alone(tiny_dataset: Dataset, tmp_path: Path) -> None:
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views

    folder, _ = make_model(tiny_dataset, tmp_path / "made")
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(folder, elsewhere / "model")
    shutil.copy(folder.parent / "method.py", elsewhere)
    view = plan_views(tiny_dataset, load_protocol("static-reconstruction"), "novel").views[0]
    (elsewhere / "view.json").write_text(view.model_dump_json())
    done = subprocess.run(
        [sys.executable, "-c", OPENING],
        cwd=elsewhere, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with np.load(folder / "colours.npz") as colours:
        expected = [*np.floor(colours[view.camera]), 1e3]
    assert [float(word) for word in done.stdout.split()] == pytest.approx(expected, abs=1.0)
    with pytest.raises(UsageError):
        open_model(elsewhere / "model")  # The document names a file, which a document does not decide to run.


def test_models_of_one_scene_or_of_two_methods_are_refused(tiny_dataset: Dataset, tmp_path: Path) -> None:
    folder, method = make_model(tiny_dataset, tmp_path)
    scene = tiny_dataset.scenes()[0]
    assert read_models([folder], method)[scene].folder == folder
    with pytest.raises(UsageError):
        read_models([folder, folder], method)
    other = tmp_path / "other"
    other.mkdir()
    document = json.loads((folder / "reconstruction.json").read_text())
    (other / "reconstruction.json").write_text(json.dumps({**document, "method": "vanilla_3dgs", "scene": "other"}))
    with pytest.raises(UsageError):
        read_models([folder, other], method)
