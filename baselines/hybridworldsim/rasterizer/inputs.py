"""Checks the arguments of `rasterization` once; an error names the argument."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.limits import check_image_size, refuse_too_many
from hybridworldsim.rasterizer.rows import has_kernels
from mirror.errors import UsageError

CameraModel = Literal["pinhole", "fisheye"]
RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
RasterizeMode = Literal["classic", "antialiased"]
NonFinite = Literal["raise", "cull"]
_MAX_LISTED = 5


@dataclass(frozen=True, eq=False, kw_only=True)
class Inputs:
    """B scenes of N Gaussians and C cameras each; B is the product of the leading dimensions of the arguments.

    Attributes:
        batch: the leading dimensions, often none.
        means: (N, 3) of each scene.
        quats: (N, 4) of each scene, scalar first, of any length from 1e-30 to 1e150.
        scales: (N, 3) of each scene.
        opacities: (N,) of each scene.
        colors: (N, D) of each scene, or of each camera of each scene; with `sh_degree` (N, K, 3). None if only depth is
            rendered.
        viewmats: (B, C, 4, 4) camera from world.
        Ks: (B, C, 3, 3) intrinsics, pixels.
        width: width of the images, pixels.
        height: height of the images, pixels.
        sh_degree: degree of the spherical harmonics in `colors`; None if `colors` are plain numbers.
        backgrounds: (B, C, D) or None.
        nonfinite: treatment of Gaussians that are not finite.
    """

    batch: tuple[int, ...]
    means: tuple[Tensor, ...]
    quats: tuple[Tensor, ...]
    scales: tuple[Tensor, ...]
    opacities: tuple[Tensor, ...]
    colors: tuple[Tensor, ...] | None
    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int
    sh_degree: int | None
    backgrounds: Tensor | None
    nonfinite: NonFinite

    @property
    def cameras(self) -> int:
        """The number of cameras, C."""
        return self.viewmats.shape[1]

    @property
    def gaussians(self) -> int:
        """The number of Gaussians, N."""
        return len(self.means[0])

    def get_colors(self, scene: int, camera: int) -> Tensor | None:
        """Get the colours (N, D) or (N, K, 3) for a camera; None if only depth is rendered."""
        if self.colors is None:
            return None
        return self.colors[scene if len(self.colors) == len(self.means) else scene * self.cameras + camera]

    def find_finite(self, scene: int, camera: int) -> Tensor | None:
        """Find the finite Gaussians of a scene, if non-finite ones are to be culled.

        Returns:
            Indices (N',) int64, ascending; None if all Gaussians are kept.
        """
        if self.nonfinite == "raise":
            return None
        tables = [self.means[scene], self.quats[scene], self.scales[scene], self.opacities[scene]]
        if (colors := self.get_colors(scene, camera)) is not None:
            tables.append(colors if self.sh_degree is None else colors[:, : (self.sh_degree + 1) ** 2])
        if all(_has_finite_sum(table) for table in tables):
            return None
        kept = torch.stack([torch.isfinite(table.detach()).reshape(self.gaussians, -1).all(1) for table in tables])
        ids = kept.all(0).nonzero()[:, 0]
        return None if len(ids) == self.gaussians else ids


def check_inputs(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor | None,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    *,
    sh_degree: int | None,
    backgrounds: Tensor | None,
    render_mode: RenderMode,
    nonfinite: NonFinite,
    reads_values: bool = True,
) -> Inputs:
    """Check shapes, types and values, and reshape each tensor to scene and camera dimensions.

    Without `reads_values` no number is read, which on a GPU would wait for all earlier work.

    Raises:
        UsageError: an argument is invalid; the error names it.
    """
    require_choice("nonfinite", nonfinite, get_args(NonFinite))
    width, height = check_image_size(width, height)
    tensors = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "viewmats": viewmats, "Ks": Ks}
    tensors |= {
        name: tensor for name, tensor in (("colors", colors), ("backgrounds", backgrounds)) if tensor is not None
    }
    for name, tensor in tensors.items():
        check_tensor(name, tensor, means)
    if means.ndim < 2:
        raise shape_error("means", means, "(..., N, 3)")
    *batch, count, _ = means.shape
    refuse_too_many(count)
    if viewmats.ndim < 3:
        raise shape_error("viewmats", viewmats, "(..., C, 4, 4)")
    cameras = viewmats.shape[-3]
    if viewmats.shape[:-2].numel() == 0:
        raise shape_error("viewmats", viewmats, "at least one camera")
    for name, shape in {
        "means": (count, 3),
        "quats": (count, 4),
        "scales": (count, 3),
        "opacities": (count,),
        "viewmats": (cameras, 4, 4),
        "Ks": (cameras, 3, 3),
    }.items():
        if tensors[name].shape != (*batch, *shape):
            raise shape_error(name, tensors[name], str((*batch, *shape)))
    scenes = means.shape[:-2].numel()
    if colors is not None:
        _check_colors(colors, batch, cameras, count, sh_degree)
    if colors is None and "RGB" in render_mode:
        raise UsageError(
            "render_mode needs colours, and none are given", place="colors", remedy='render_mode="D" or "ED"'
        )
    if backgrounds is not None:
        channels = 3 if sh_degree is not None or colors is None else colors.shape[-1]
        if "RGB" in render_mode and backgrounds.shape != (*batch, cameras, channels):
            raise shape_error("backgrounds", backgrounds, str((*batch, cameras, channels)))
        backgrounds = backgrounds.reshape(scenes, cameras, backgrounds.shape[-1])
    inputs = Inputs(
        batch=tuple(batch),
        means=_split_tables(means, 2),
        quats=_split_tables(quats, 2),
        scales=_split_tables(scales, 2),
        opacities=_split_tables(opacities, 1),
        colors=_split_tables(colors, 2 if sh_degree is None else 3)
        if colors is not None and "RGB" in render_mode
        else None,
        viewmats=viewmats.reshape(scenes, cameras, 4, 4),
        Ks=Ks.reshape(scenes, cameras, 3, 3),
        width=width,
        height=height,
        sh_degree=sh_degree,
        backgrounds=backgrounds,
        nonfinite=nonfinite,
    )
    if not reads_values:
        return inputs
    x, y, z = inputs.viewmats.detach()[..., :3, :3].unbind(-2)
    if bool(((torch.linalg.cross(x, y) * z).sum(-1) == 0.0).any()):
        raise UsageError("a rotation is singular", place="viewmats", expected="camera from world, (..., C, 4, 4)")
    focal = inputs.Ks.detach().diagonal(dim1=-2, dim2=-1)[..., :2]
    if bool((focal == 0.0).any()):
        raise UsageError("a focal length is 0", place="Ks", expected="fx and fy other than 0")
    for name in ("viewmats", "Ks", "backgrounds"):
        if name in tensors:
            refuse_nonfinite(name, tensors[name].flatten(0, len(batch)), "image")
    if nonfinite == "raise":
        for name in ("means", "quats", "scales", "opacities"):
            refuse_nonfinite(name, tensors[name].flatten(0, len(batch)), "Gaussian")
    return inputs


def make_lenses(
    inputs: Inputs,
    camera_model: CameraModel,
    with_ut: bool,
    coefficients: dict[str, Tensor | None],
) -> Sequence[LensDistortion | None]:
    """Make the lens of each image; None for a pinhole, which EWA splatting projects.

    Args:
        inputs: the checked inputs.
        camera_model: camera model of all cameras.
        with_ut: whether to use the unscented transform; distortion and fisheyes need it.
        coefficients: (..., C, number) each, by gsplat's names.

    Raises:
        UsageError: two arguments exclude each other.
    """
    given = {name: tensor for name, tensor in coefficients.items() if tensor is not None}
    if not with_ut:
        for name in given:
            raise UsageError("distortion without the unscented transform", place=name, remedy="with_ut=True")
        if camera_model != "pinhole":
            raise UsageError(
                f"a {camera_model} without the unscented transform", place="camera_model", remedy="with_ut=True"
            )
        return [None] * len(inputs.means) * inputs.cameras
    leading = (*inputs.batch, inputs.cameras)
    tables: dict[str, list[list[float]]] = {}
    for name, tensor in given.items():
        check_tensor(name, tensor, inputs.means[0])
        if tensor.shape[:-1] != leading:
            raise shape_error(name, tensor, f"({', '.join(map(str, leading))}, coefficients)")
        tables[name] = tensor.detach().reshape(-1, tensor.shape[-1]).tolist()
    return [
        LensDistortion(model=camera_model, **{name: tuple(table[image]) for name, table in tables.items()})
        for image in range(len(inputs.means) * inputs.cameras)
    ]


def refuse_nonfinite(name: str, table: Tensor, row: str, ids: Tensor | None = None) -> None:
    """Raise an error if a table holds numbers that are not finite; the check of a finite table costs one sum.

    Args:
        name: name of the argument.
        table: (N, ...).
        row: word for a row, for the message.
        ids: (N,) index of each row in the argument; None if the rows are the argument's rows.

    Raises:
        UsageError: a row is not finite; the message lists the first such rows.
    """
    if _has_finite_sum(table):
        return
    bad = (~torch.isfinite(table.detach()).reshape(len(table), -1).all(1)).nonzero()[:, 0]
    if len(bad) == 0:
        return
    rows = "rows" if ids is None else "visible rows"
    first = (bad[:_MAX_LISTED] if ids is None else ids[bad[:_MAX_LISTED]]).tolist()
    raise UsageError(
        f"{len(bad)} of {len(table)} {rows} hold NaN or infinity: {row} {', '.join(map(str, first))}"
        + (" ..." if len(bad) > _MAX_LISTED else ""),
        place=name,
        remedy='find what wrote them, or pass nonfinite="cull" to leave them out, counted'
        if row == "Gaussian"
        else None,
    )


def require_choice(place: str, value: object, expected: tuple[str, ...]) -> None:
    """Check that a value is one of the expected words.

    Raises:
        UsageError: it is not; the error lists the words.
    """
    if value not in expected:
        raise UsageError(f"no such choice: {value!r}", place=place, expected=" or ".join(map(repr, expected)))


def require_flag(place: str, value: bool) -> bool:
    """Check that a value is a bool; other values are refused although Python can convert them.

    Raises:
        UsageError: it is no bool.
    """
    if not isinstance(value, bool | np.bool_):
        raise UsageError(f"{value!r} is no bool", place=place, expected="True or False")
    return bool(value)


def require_at_least(place: str, value: float, least: float) -> float:
    """Check that a number is at least a minimum.

    Raises:
        UsageError: it is smaller, or NaN.
    """
    if not value >= least:
        raise UsageError(f"{value!r} is too small or no number", place=place, expected=f"at least {least:g}")
    return float(value)


def _check_colors(colors: Tensor, batch: list[int], cameras: int, count: int, sh_degree: int | None) -> None:
    """Check the shape of colours."""
    last = 1 if sh_degree is None else 2
    per_gaussian = (*batch, count)
    per_camera = (*batch, cameras, count)
    leading = colors.shape[:-last]
    if leading not in (per_gaussian, per_camera):
        tail = "D" if sh_degree is None else "K, 3"
        expected = " or ".join(f"({', '.join(map(str, shape))}, {tail})" for shape in (per_gaussian, per_camera))
        raise shape_error("colors", colors, expected)
    if sh_degree is not None:
        needed = (sh_degree + 1) ** 2
        if not 0 <= sh_degree <= 4:
            raise UsageError(f"no spherical harmonics of degree {sh_degree}", place="sh_degree", expected="0 to 4")
        if colors.shape[-1] != 3 or colors.shape[-2] < needed:
            raise shape_error("colors", colors, f"(..., K, 3) with K of at least {needed} for degree {sh_degree}")
    elif colors.shape[-1] == 0:
        raise shape_error("colors", colors, "at least one channel")


def _split_tables(tensor: Tensor, dimensions: int) -> tuple[Tensor, ...]:
    """Split a tensor along its leading dimensions; a single part is the tensor itself, without a copy of gradients."""
    count, table = tensor.shape[:-dimensions].numel(), tensor.shape[-dimensions:]
    return (tensor.reshape(table),) if count == 1 else tensor.reshape(count, *table).unbind()


def check_tensor(name: str, tensor: Tensor, means: Tensor) -> None:
    """Check type, dtype and device of a tensor."""
    if not isinstance(tensor, Tensor):
        raise UsageError(f"a {type(tensor).__name__}", place=name, expected="a torch tensor")
    if tensor.dtype not in (torch.float32, torch.float64):
        raise UsageError(str(tensor.dtype), place=name, expected="float32 or float64")
    if tensor.device != means.device:
        raise UsageError(f"on {tensor.device}", place=name, expected=f"on {means.device}, where the means are")


def shape_error(name: str, tensor: Tensor, expected: str) -> UsageError:
    """Make the error for a tensor of a wrong shape."""
    return UsageError(f"shape {tuple(tensor.shape)}", place=name, expected=expected)


def _has_finite_sum(table: Tensor) -> bool:
    """Return whether the sum of a table is finite: a cheap test that all its numbers are finite."""
    if has_kernels(table):
        from hybridworldsim.rasterizer.cpu import tables

        return math.isfinite(tables.sum_table(table))
    return math.isfinite(table.detach().sum().item())
