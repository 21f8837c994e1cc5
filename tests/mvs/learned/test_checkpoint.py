import dataclasses

import pytest
import torch

from hybridworldsim.mvs.mvsnet.estimator import MVSNetEstimator
from hybridworldsim.mvs.mvsnet.network import MVSNet
from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator
from hybridworldsim.mvs.patchmatchnet.network import PatchmatchNet
from mirror.weights import resolve
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import WeightResolver, file_sha256
from mirror.weights.table import KNOWN
from tests.mvs.learned.images import randomise

ESTIMATORS = {"mvsnet": MVSNetEstimator, "patchmatchnet": PatchmatchNetEstimator}


@pytest.fixture
def no_weights_folder(monkeypatch, tmp_path):
    """Points all search paths of weights to empty folders."""
    monkeypatch.delenv("MIRROR_WEIGHTS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))


def save(tmp_path, state, prefix="module."):
    path = tmp_path / "model.ckpt"
    torch.save({"epoch": 1, "model": {prefix + key: value for key, value in state.items()}, "optimizer": {}}, path)
    return path


@pytest.mark.parametrize("name", ESTIMATORS)
def test_message_of_missing_weights_names_file_hash_source_and_flag(no_weights_folder, name):
    with pytest.raises(WeightsUnavailableError) as caught:
        ESTIMATORS[name].load()
    known = KNOWN[name]
    for part in (known.filename, known.sha256 or "not published", known.url, f"--weights {name}=FILE", known.licence):
        assert part in str(caught.value)


def test_patchmatchnet_checkpoint_is_pinned(no_weights_folder, tmp_path):
    path = save(tmp_path, randomise(PatchmatchNet(), 0).state_dict())
    with pytest.raises(WeightsUnavailableError, match=r"another file|bytes"):
        PatchmatchNetEstimator.load(WeightResolver({"patchmatchnet": path}))


@pytest.mark.parametrize("prefix", ["module.", ""])
@pytest.mark.parametrize("refine", [False, True])
def test_mvsnet_loads_public_keys(no_weights_folder, tmp_path, prefix, refine):
    network = randomise(MVSNet(refine=refine), 1)
    path = save(tmp_path, network.state_dict(), prefix)
    loaded = MVSNetEstimator.load(WeightResolver({"mvsnet": path})).network
    assert (loaded.refine_network is not None) == refine
    torch.testing.assert_close(loaded.cost_regularization.prob.weight, network.cost_regularization.prob.weight)
    rgb = torch.rand(3, 32, 32)
    with torch.inference_mode():
        torch.testing.assert_close(loaded.feature(rgb), network.feature(rgb), rtol=1e-4, atol=1e-4)


def test_other_tensors_are_refused(no_weights_folder, tmp_path):
    state = randomise(MVSNet(refine=False), 2).state_dict()
    short = {key: value for key, value in state.items() if key != "feature.conv0.conv.weight"}
    wide = state | {"feature.conv0.conv.weight": torch.zeros(9, 3, 3, 3)}
    more = state | {"feature.conv99.conv.weight": torch.zeros(1)}
    for changed, what in ((short, "is missing"), (wide, r"\(9, 3, 3, 3\)"), (more, "is not part of it")):
        path = save(tmp_path, changed)
        with pytest.raises(WeightsUnavailableError, match=what):
            MVSNetEstimator.load(WeightResolver({"mvsnet": path}))


def test_files_of_another_kind_are_refused(no_weights_folder, tmp_path):
    path = tmp_path / "model.ckpt"
    torch.save({"weights": torch.zeros(3)}, path)
    with pytest.raises(WeightsUnavailableError, match="no entry 'model'"):
        MVSNetEstimator.load(WeightResolver({"mvsnet": path}))
    path.write_bytes(b"<html>not a checkpoint</html>")
    with pytest.raises(WeightsUnavailableError, match="no state dict"):
        MVSNetEstimator.load(WeightResolver({"mvsnet": path}))


def test_pinned_checkpoint_loads(no_weights_folder, tmp_path, monkeypatch):
    path = save(tmp_path, randomise(PatchmatchNet(), 3).state_dict())
    known = dataclasses.replace(KNOWN["patchmatchnet"], sha256=file_sha256(path), size=None)
    monkeypatch.setattr(resolve, "KNOWN", KNOWN | {"patchmatchnet": known})
    loaded = PatchmatchNetEstimator.load(WeightResolver({"patchmatchnet": path}))
    assert repr(loaded) == f"PatchmatchNetEstimator(sha256='{known.sha256}', seed=0, threads=1)"
