"""Processes with the instruction set of another x86-64 processor, in every library that selects instructions."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

_WITHOUT_AVX512: Final = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+avx2,+fma,+bmi,+bmi2",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Haswell",
    "OPENCV_CPU_DISABLE": "AVX512_ICL,AVX512_SKX,AVX512_COMMON",
}
_WITHOUT_FMA: Final = {
    "NUMBA_CPU_NAME": "x86-64-v2",
    "NUMBA_CPU_FEATURES": "",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL X86_V3",
    "OPENBLAS_CORETYPE": "Nehalem",
    "OPENCV_CPU_DISABLE": "AVX512_ICL,AVX512_SKX,AVX512_COMMON,AVX2,FMA3,AVX,FP16",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4",
}
INSTRUCTION_SETS: Final[Mapping[str, Mapping[str, str]]] = {
    "all instructions": {},
    "without AVX-512": _WITHOUT_AVX512,
    "without AVX-512, AVX2 and FMA": _WITHOUT_FMA,
}
"""Environment variables that restrict a process to the instructions of other x86-64 processors, by their name."""


def restricted(features: Mapping[str, str], cache: Path) -> dict[str, str]:
    """Return the environment of a process with these instructions; its compiled kernels are kept in a folder."""
    return {**os.environ, **features, "NUMBA_CACHE_DIR": str(cache)}
