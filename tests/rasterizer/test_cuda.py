"""On CUDA gsplat is called: with what it was given, and only if it renders as the preset says."""

from __future__ import annotations

import sys
from enum import IntEnum
from types import SimpleNamespace

import pytest
import torch

from hybridworldsim.rasterizer import RollingShutterType, cuda, rasterization
from hybridworldsim.rasterizer.presets import PRESETS
from hybridworldsim.rasterizer.rasterization import choose_backend
from mirror.errors import UsageError
from tests.rasterizer.scenes import scene


@pytest.fixture
def gsplat(monkeypatch):
    """A gsplat that says what it was called with; on the CPU, where none is needed to be."""
    fake = SimpleNamespace(__version__="1.5.3", rasterization=lambda **received: ("images", "alphas", received))
    monkeypatch.setitem(sys.modules, "gsplat", fake)
    # the package has a function of this module's name
    module = sys.modules["hybridworldsim.rasterizer.rasterization"]
    monkeypatch.setattr(module, "choose_backend", lambda name, device: "cuda")
    return fake


def test_the_backend_is_where_the_tensors_are():
    assert choose_backend("auto", torch.device("cpu")) == "cpu"
    assert choose_backend("auto", torch.device("cuda", 1)) == "cuda"
    assert choose_backend("reference", torch.device("cpu")) == "reference"
    for name, device in (("cuda", "cpu"), ("cpu", "cuda"), ("reference", "cuda")):
        with pytest.raises(UsageError, match="tensors are on"):
            choose_backend(name, torch.device(device))
    with pytest.raises(UsageError, match="tensors are on cpu"):
        rasterization(**scene(), backend="cuda")


def test_gsplat_is_called_with_what_it_was_given(gsplat):
    arguments = scene(views=2) | {"radius_clip": 2.0, "render_mode": "RGB+ED", "packed": False, "absgrad": True}
    images, alphas, received = rasterization(**arguments, backend="cuda")
    assert (images, alphas) == ("images", "alphas")
    assert all(received[name] is value for name, value in arguments.items())
    # arguments that older releases lack are not passed as long as they say nothing
    assert not {"camera_model", "segmented", "with_ut", "radial_coeffs", "covars", "backend", "preset"} & set(received)


def test_depth_alone_has_colours_to_pass(gsplat):
    _, _, received = rasterization(**scene() | {"colors": None, "render_mode": "D"}, backend="cuda")
    assert received["colors"].shape == (40, 1)


def test_lenses_reach_gsplat(gsplat):
    lens = {"radial_coeffs": torch.zeros(1, 4), "with_ut": True, "camera_model": "fisheye", "packed": False}
    _, _, received = rasterization(**scene(), **lens, backend="cuda")
    assert all(received[name] is value for name, value in lens.items())


def test_rolling_shutters_reach_gsplat_as_its_own_type(gsplat, monkeypatch):
    own = IntEnum("RollingShutterType", {"ROLLING_LEFT_TO_RIGHT": 1, "GLOBAL": 4})
    monkeypatch.setitem(sys.modules, "gsplat.cuda", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "gsplat.cuda._wrapper", SimpleNamespace(RollingShutterType=own))
    ends = torch.eye(4)[None]
    rolling = {"with_ut": True, "packed": False, "viewmats_rs": ends}
    _, _, received = rasterization(
        **scene(), **rolling, rolling_shutter=RollingShutterType.ROLLING_LEFT_TO_RIGHT, backend="cuda"
    )
    assert received["rolling_shutter"] is own.ROLLING_LEFT_TO_RIGHT
    assert received["viewmats_rs"] is ends
    with pytest.raises(UsageError, match="does not antialias"):
        rasterization(**scene(), with_ut=True, packed=False, rasterize_mode="antialiased", backend="cuda")


@pytest.mark.parametrize(
    ("version", "preset"),
    [("1.3.0", "gsplat-1.3"), ("1.4.0", "gsplat-1.3"), ("1.5.3", "gsplat-1.5"), ("1.6.0", "gsplat-1.6")],
)
def test_a_preset_is_taken_from_the_releases_that_it_follows_alone(gsplat, version, preset):
    gsplat.__version__ = version
    for name in PRESETS:
        if name == preset:
            rasterization(**scene(), backend="cuda", preset=name)
            continue
        with pytest.raises(UsageError, match=f"gsplat {version} is installed") as caught:
            rasterization(**scene(), backend="cuda", preset=name)
        assert preset in str(caught.value.remedy)


def test_a_release_that_no_preset_follows_is_refused(gsplat):
    gsplat.__version__ = "2.0.1+cu130"
    with pytest.raises(UsageError, match=r"gsplat 2\.0\.1"):
        rasterization(**scene(), backend="cuda")


def test_what_gsplat_does_not_do_is_refused_before_it_is_called(gsplat):
    with pytest.raises(UsageError, match="not packed"):
        rasterization(**scene(), backend="cuda", with_ut=True)
    broken = scene()
    broken["colors"][5] = torch.nan
    with pytest.raises(UsageError, match="row 5"):
        rasterization(**broken, backend="cuda")


def test_gaussians_that_are_not_finite_are_made_transparent_and_get_no_gradient(gsplat):
    arguments = scene()
    arguments["means"][3, 1], arguments["quats"][5, 0], arguments["colors"][7, 2] = torch.nan, torch.inf, torch.nan
    leaves = {name: arguments[name].requires_grad_() for name in ("means", "quats", "scales", "opacities", "colors")}
    _, _, received = rasterization(**arguments, backend="cuda", nonfinite="cull")
    kept = torch.ones(40, dtype=torch.bool)
    kept[[3, 5, 7]] = False
    for name, leaf in leaves.items():
        assert received[name].isfinite().all() and torch.equal(received[name][kept], leaf[kept])
        (gradient,) = torch.autograd.grad(received[name].sum(), leaf)
        assert not gradient[~kept].any() and (gradient[kept] == 1.0).all()
    assert not received["opacities"][~kept].any()


@pytest.mark.parametrize(("version", "preset"), [("1.5.3", "gsplat-1.5"), ("1.6.0+cu130", "gsplat-1.6")])
def test_a_model_renders_as_the_installed_gsplat_does(gsplat, version, preset):
    gsplat.__version__ = version
    assert cuda.preset_on(torch.device("cuda", 0)) == preset
    assert cuda.preset_on(torch.device("cpu")) == "gsplat-1.5"


def test_a_missing_gsplat_is_said_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(UsageError, match=r"pip install .*\[gpu\]"):
        cuda.rasterization(PRESETS["gsplat-1.5"], "raise")
