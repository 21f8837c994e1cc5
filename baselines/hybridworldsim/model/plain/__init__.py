"""Plain torch forms of the computations that are compiled for the CPU: for any device, and for tests of the kernels."""
