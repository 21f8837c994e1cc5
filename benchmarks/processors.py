"""Instruction sets of other x86-64 processors, as environment variables of a process.

They restrict the compiler of the kernels (numba), numpy, BLAS, OpenCV and the C library. OpenBLAS has kernels of its own
for each family: it takes ``Haswell`` on most processors of AMD and on Intel's without AVX-512.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

HASWELL_BLAS: Final[Mapping[str, str]] = {"OPENBLAS_CORETYPE": "Haswell"}
"""All instructions, and the BLAS kernels of most processors of AMD."""

WITHOUT_AVX512: Final[Mapping[str, str]] = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+avx2,+fma,+bmi,+bmi2",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Haswell",
    "OPENCV_CPU_DISABLE": "AVX512_ICL,AVX512_SKX,AVX512_COMMON",
}
"""A processor of the x86-64-v3 level."""

WITHOUT_FMA: Final[Mapping[str, str]] = {
    "NUMBA_CPU_NAME": "x86-64-v2",
    "NUMBA_CPU_FEATURES": "",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL X86_V3",
    "OPENBLAS_CORETYPE": "Nehalem",
    "OPENCV_CPU_DISABLE": "AVX512_ICL,AVX512_SKX,AVX512_COMMON,AVX2,FMA3,AVX,FP16",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4",
}
"""A processor of the x86-64-v2 level: no fused products, other orders of sums."""
