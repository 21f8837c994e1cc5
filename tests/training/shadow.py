"""A stand-in for a GPU: tensors that say they are on the meta device and hold their numbers on the CPU.

An operation that mixes them with tensors of the CPU is refused, as on a GPU, except numbers without dimensions, and
they have no memory that numpy could see. So a computation that runs on them would run on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from hybridworldsim.rasterizer import rasterization

DEVICE = "meta"
_COPIES = (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default, torch.ops.aten.index_put_.default)


WAITS: list[str] = []
"""Operations so far for which a program would wait for the GPU: what reads numbers or their count back, and copies that
do not return at once."""
_READS = ("_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim", "equal", "is_nonzero")


class Shadow(Tensor):
    """A tensor whose numbers are those of a tensor on the CPU."""

    inner: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> Shadow:
        made: Shadow = Tensor._make_wrapper_subclass(
            cls, inner.shape, strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype,
            device=DEVICE, requires_grad=False,
        )  # fmt: skip
        made.inner = inner
        return made

    def tolist(self) -> Any:
        """Read the numbers back, as from a GPU."""
        WAITS.append("tolist")
        return self.inner.tolist()

    @classmethod
    def __torch_dispatch__(
        cls, function: Any, types: Sequence[type], args: tuple[Any, ...] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        return _run(function, args, kwargs or {})


class OnShadows(TorchDispatchMode):
    """A context in which new tensors on the meta device are shadows."""

    def __torch_dispatch__(
        self, function: Any, types: Sequence[type], args: tuple[Any, ...] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        return _run(function, args, kwargs or {})


def _run(function: Any, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
    leaves = tree_leaves((args, kwargs))
    shadows = [leaf for leaf in leaves if isinstance(leaf, Shadow)]
    others = [leaf for leaf in leaves if isinstance(leaf, Tensor) and not isinstance(leaf, Shadow)]
    if shadows and any(other.dim() for other in others) and function not in _COPIES:
        raise RuntimeError(f"{function} mixes devices: {[(tuple(one.shape), one.dtype) for one in others]}")
    _record_waits(function, args, kwargs, shadows)
    asked = kwargs.get("device")
    device = DEVICE if shadows else "cpu"
    if asked is not None:
        device, kwargs = torch.device(asked).type, {**kwargs, "device": torch.device("cpu")}
    elif function is torch.ops.aten.copy_.default:
        device = DEVICE if isinstance(args[0], Shadow) else "cpu"
    known = {id(one.inner): one for one in shadows}
    found = function(*tree_map(_inner, args), **tree_map(_inner, dict(kwargs)))

    def wrap(one: Any) -> Any:
        if not isinstance(one, Tensor) or device != DEVICE:
            return one
        return known.get(id(one)) if id(one) in known else Shadow(one)

    return tree_map(wrap, found)


def _record_waits(function: Any, args: tuple[Any, ...], kwargs: Mapping[str, Any], shadows: Sequence[Shadow]) -> None:
    name = function.overloadpacket.__name__
    asked = None if kwargs.get("device") is None else torch.device(kwargs["device"]).type
    is_mask = name in ("index", "index_put", "index_put_") and any(
        isinstance(one, Tensor) and one.dtype == torch.bool for one in args[1]
    )
    reads = bool(shadows) and (name in _READS or is_mask or (name == "_to_copy" and asked == "cpu"))
    blocks = name == "_to_copy" and asked == DEVICE and not shadows and not kwargs.get("non_blocking")
    between = name == "copy_" and len({isinstance(one, Shadow) for one in args[:2]}) == 2
    non_blocking = kwargs.get("non_blocking", args[2] if len(args) > 2 else False)
    if reads or blocks or (between and not non_blocking):
        WAITS.append(name)


def _inner(one: Any) -> Any:
    return one.inner if isinstance(one, Shadow) else one


class _Images:
    """Gradients of the Gaussians in the image, as gsplat's `means2d` has them."""

    absgrad: Tensor | None = None
    grad: Tensor | None = None

    def retain_grad(self) -> None:
        """Keep the gradient, which is kept in any case."""


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, names: Sequence[str], options: dict[str, Any], meta: dict[str, Any], *tables: Tensor) -> Any:
        inner = [table.detach().inner for table in tables]
        with torch.enable_grad():
            leaves = [one.clone().requires_grad_(one.is_floating_point()) for one in inner]
            images, alphas, found = rasterization(**dict(zip(names, leaves, strict=True)), **options)
            if found["means2d"].requires_grad:
                found["means2d"].retain_grad()
        ctx.leaves, ctx.results, ctx.found, ctx.meta = leaves, (images, alphas), found, meta
        meta |= {name: found[name] for name in ("width", "height", "n_cameras")}
        meta |= {name: Shadow(found[name].detach()) for name in ("gaussian_ids", "radii")}
        meta["means2d"] = _Images()
        return Shadow(images.detach()), Shadow(alphas.detach())

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        torch.autograd.backward(ctx.results, [gradient.inner for gradient in gradients])
        means2d = ctx.found["means2d"]
        for name in ("absgrad", "grad"):
            gradient = getattr(means2d, name, None)
            setattr(ctx.meta["means2d"], name, None if gradient is None else Shadow(gradient))
        return (None, None, None, *(None if leaf.grad is None else Shadow(leaf.grad) for leaf in ctx.leaves))


def rasterize_shadows(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, viewmats: Tensor, Ks: Tensor,
    width: int, height: int, **options: Any,
) -> tuple[Tensor, Tensor, dict[str, Any]]:  # fmt: skip
    """Rasterize shadows by the CPU's kernels, in place of gsplat."""
    tables = {
        "means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors,
        "viewmats": viewmats, "Ks": Ks,
    }  # fmt: skip
    assert all(isinstance(table, Shadow) for table in tables.values()), "a table is not on the device"
    meta: dict[str, Any] = {}
    size = {"width": width, "height": height}
    images, alphas = _Rasterize.apply(tuple(tables), {**options, **size}, meta, *tables.values())
    return images, alphas, meta


def without_fused(adam: Callable[..., Any]) -> Callable[..., Any]:
    """Adam without torch's fused kernel, which knows no shadows."""
    return lambda *args, fused, **options: adam(*args, **options)
