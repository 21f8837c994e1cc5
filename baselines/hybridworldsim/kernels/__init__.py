"""Tools of compiled kernels: compilation, SIMD vectors, aligned memory and threads."""
