"""What compiled kernels share: compilation, SIMD vectors, aligned memory and threads."""
