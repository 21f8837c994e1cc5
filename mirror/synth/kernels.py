"""How what runs for every pixel is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def per_pixel(
    *, inline: Literal["never", "always"] = "never", contract: bool = False
) -> Callable[[_Function], _Function]:
    """Compile a function that allocates nothing, without reference counts: they would cost a fifth of an image's time.

    Args:
        inline: ``always``: into the kernels that call it.
        contract: whether products and sums may be fused.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "inline": inline, "_nrt": False}
    if contract:
        options["fastmath"] = {"contract"}
    found: Callable[[_Function], _Function] = numba.njit(**options)
    return found
