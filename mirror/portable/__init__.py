"""Mathematics with the same bits on every x86-64 processor: `scalars` for numbers and kernels, `arrays` for arrays.

numpy, its BLAS and the C library select instructions by processor (AVX-512, FMA), and their results differ in the last
bit. The world of a synthetic street must not: a hash of its images identifies a generated dataset. These functions use
only operations that IEEE 754 rounds exactly (+, -, *, /, sqrt), without fused products, in a fixed order.
"""
