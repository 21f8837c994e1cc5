"""The densification strategies of gsplat run on our `meta` as they are."""

from __future__ import annotations

import pytest
import torch

from hybridworldsim.rasterizer import rasterization
from tests.rasterizer.scenes import cameras, gaussians

gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed: its strategies are what is tried here")
WIDTH, HEIGHT, VIEWS = 64, 48, 3


def _target():
    drawn = gaussians(60, seed=5) | cameras(VIEWS, WIDTH, HEIGHT)
    with torch.no_grad():
        return rasterization(**drawn)[0]


def _fit(strategy, state, steps, *, absgrad=False, views=slice(None), **received):
    """Fit few Gaussians to an image of more; the losses, and how many there were."""
    drawn = gaussians(15, seed=9)
    rates = {"means": 0.02, "quats": 0.02, "scales": 0.02, "opacities": 0.05, "colors": 0.05}
    drawn["scales"], drawn["opacities"] = drawn["scales"].log(), torch.logit(drawn["opacities"].clamp(0.1, 0.9))
    params = torch.nn.ParameterDict({name: torch.nn.Parameter(drawn[name]) for name in rates})
    optimizers = {name: torch.optim.Adam([params[name]], lr=rate) for name, rate in rates.items()}
    strategy.check_sanity(params, optimizers)
    camera, target = cameras(VIEWS, WIDTH, HEIGHT), _target()[views]
    camera |= {name: camera[name][views] for name in ("viewmats", "Ks")}
    losses, counts = [], []
    for step in range(steps):
        image, _, meta = rasterization(
            params["means"],
            params["quats"],
            params["scales"].exp(),
            params["opacities"].sigmoid(),
            params["colors"],
            **camera,
            absgrad=absgrad,
            packed=received.get("packed", True),
        )
        loss = (image - target).abs().mean()
        if hasattr(strategy, "step_pre_backward"):
            strategy.step_pre_backward(params, optimizers, state, step, meta)
        loss.backward()
        strategy.step_post_backward(params, optimizers, state, step, meta, **received)
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad()
        losses.append(loss.item())
        counts.append(len(params["means"]))
    return losses, counts


@pytest.mark.parametrize(("absgrad", "views"), [(True, slice(0, 1)), (False, slice(None))])
def test_the_default_strategy_densifies_and_the_fit_improves(absgrad, views):
    found = []
    for packed in (True, False):
        torch.manual_seed(0)
        strategy = gsplat.DefaultStrategy(
            refine_start_iter=5,
            refine_every=15,
            reset_every=1000,
            refine_scale2d_stop_iter=100,
            grow_grad2d=0.002 if absgrad else 0.001,
            absgrad=absgrad,
        )
        state = strategy.initialize_state(scene_scale=5.0)
        found.append(_fit(strategy, state, 46, absgrad=absgrad, views=views, packed=packed))
    losses, counts = found[0]
    assert found[0] == found[1]
    assert losses[-1] < 0.6 * losses[0]
    assert counts[-1] > counts[0]


def test_what_the_default_strategy_gathers_is_what_meta_says():
    strategy = gsplat.DefaultStrategy(refine_start_iter=10**6)
    state = strategy.initialize_state()
    _fit(strategy, state, 1, packed=True)
    drawn = gaussians(15, seed=9)
    drawn["scales"], drawn["opacities"] = drawn["scales"], drawn["opacities"].clamp(0.1, 0.9)
    drawn["means"].requires_grad_()
    image, _, meta = rasterization(**drawn, **cameras(VIEWS, WIDTH, HEIGHT))
    meta["means2d"].retain_grad()
    (image - _target()).abs().mean().backward()
    count = torch.bincount(meta["gaussian_ids"], minlength=15)
    assert torch.equal(state["count"], count.float())
    scaled = meta["means2d"].grad * torch.tensor([WIDTH, HEIGHT]) / 2.0 * VIEWS
    grad2d = torch.zeros(15).index_add(0, meta["gaussian_ids"], scaled.norm(dim=-1))
    torch.testing.assert_close(state["grad2d"], grad2d, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_meta_and_colours_are_those_of_the_formulas_that_gsplat_keeps_in_torch(backend):
    torch_impl = pytest.importorskip("gsplat.cuda._torch_impl")
    drawn = {name: tensor.double() for name, tensor in gaussians(200, seed=3).items()}
    camera = {k: v.double() if isinstance(v, torch.Tensor) else v for k, v in cameras(VIEWS, WIDTH, HEIGHT).items()}
    drawn["colors"] = torch.randn(200, 16, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    covariances, _ = torch_impl._quat_scale_to_covar_preci(drawn["quats"], drawn["scales"], compute_preci=False)
    radii, means2d, depths, conics, compensations = torch_impl._fully_fused_projection(
        drawn["means"], covariances, **camera, calc_compensations=True
    )
    image, _, meta = rasterization(
        **drawn, **camera, backend=backend, packed=False, rasterize_mode="antialiased", sh_degree=3
    )
    seen = (meta["radii"] > 0).all(-1)
    assert seen.sum() > 200
    opacities = (drawn["opacities"] * compensations)[seen]
    for name, expected in (("means2d", means2d), ("depths", depths), ("conics", conics)):
        torch.testing.assert_close(meta[name][seen].double(), expected[seen], rtol=2e-5, atol=1e-5)
    torch.testing.assert_close(meta["opacities"][seen].double(), opacities, rtol=2e-5, atol=1e-6)
    assert (radii[seen] > 0).all()  # that of gsplat's formula does not know opacity, it is the larger
    directions = drawn["means"] - torch.linalg.inv(camera["viewmats"])[:, None, :3, 3]
    colors = (torch_impl._spherical_harmonics(3, directions, drawn["colors"].expand(VIEWS, -1, -1, -1)) + 0.5).clamp(0)
    plain, _, _ = rasterization(**drawn | {"colors": colors}, **camera, backend=backend, rasterize_mode="antialiased")
    torch.testing.assert_close(image, plain, rtol=1e-5, atol=1e-5)
