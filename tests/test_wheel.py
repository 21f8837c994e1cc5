"""The wheel works without the repository and without the optional packages."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.pages.templates import TEMPLATES, package_of

ROOT = Path(__file__).resolve().parents[1]
MAIN = "import sys; from mirror.cli.main import main; sys.exit(main(sys.argv[1:]))"
HIDE_PACKAGES = """
import sys
from importlib.machinery import PathFinder


class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {names} else super().find_spec(name, path, target)


sys.meta_path[sys.meta_path.index(PathFinder)] = Finder
"""
IMPORT_NAMES = {"opencv-contrib-python-headless": "cv2", "rerun-sdk": "rerun"}


def extras() -> set[str]:
    """Import names of the packages that only extras install."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = [line for lines in project["optional-dependencies"].values() for line in lines]
    names = {line.partition("[")[0].partition(">")[0] for line in optional} - {"mirror-dataset"}
    return {IMPORT_NAMES.get(name, name.replace("-", "_")) for name in names} | {"torchvision", "PIL", "skimage"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the wheel installs, in which no package of an extra can be imported."""
    work = tmp_path_factory.mktemp("wheel")
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if tracked.returncode:
        pytest.skip("the source tree is no git checkout: the list of its files is not known")
    for name in filter(None, tracked.stdout.split("\0")):
        if not name.startswith(("tests/", "benchmarks/", "docs/")) and (ROOT / name).is_file():
            (work / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, work / "source" / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(work), str(work / "source")], check=True)
    (wheel,) = work.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(work / "site")
    (work / "site" / "sitecustomize.py").write_text(HIDE_PACKAGES.format(names=sorted(extras())))
    return work / "site"


def run(site: Path, cwd: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the wheel's packages, in a folder outside the repository."""
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run([sys.executable, *words], cwd=cwd, env=environment, capture_output=True, text=True)


def test_wheel_has_four_packages(site: Path) -> None:
    assert {path.name for path in site.iterdir() if path.is_dir() and path.suffix != ".dist-info"} == {
        "mirror",
        "hybridworldsim",
        "mirror_baselines",
        "mirror_leaderboard",
    }


def test_protocols_open_from_the_wheel(site: Path, tmp_path: Path) -> None:
    code = """
import json, mirror, importlib.util
from mirror.protocols.document import load_protocol, protocol_names
names = protocol_names()
print(json.dumps([mirror.__file__, importlib.util.find_spec("mirror").origin, [load_protocol(n).name for n in names]]))
"""
    done = run(site, tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr
    module, origin, protocols = json.loads(done.stdout)
    assert Path(module).is_relative_to(site)
    assert Path(origin).is_relative_to(site)
    assert "static-reconstruction" in protocols


def test_templates_of_pages_are_in_the_wheel(site: Path, tmp_path: Path) -> None:
    names = [(package_of(path), path.name) for path in TEMPLATES]
    code = f"""
from mirror.pages.rendering import load_environment, style_sheet
assert len(style_sheet()) > 1000
for package, name in {names!r}:
    print(load_environment(package).get_template(name).filename)
"""
    done = run(site, tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr
    assert len(names) > 1 and len(done.stdout.splitlines()) == len(names)
    assert all(Path(line).is_relative_to(site) for line in done.stdout.splitlines())


@pytest.mark.skipif("MIRROR_WHEEL_DEMO" not in os.environ, reason="kernels compile for minutes: `make wheel` runs it")
def test_quick_demo_runs_from_the_wheel_without_extras(site: Path, tmp_path: Path) -> None:
    absent = run(site, tmp_path, "-c", "import torch")
    assert absent.returncode == 1
    assert "ModuleNotFoundError" in absent.stderr
    done = run(site, tmp_path, "-c", MAIN, "demo", "--quick", "--out", "demo")
    assert done.returncode == 0, done.stdout + done.stderr
    for page in ("report.html", "site/index.html"):
        assert (tmp_path / "demo" / page).stat().st_size > 1000, sorted((tmp_path / "demo").iterdir())
