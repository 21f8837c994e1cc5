"""Plain torch forms of stereo without networks: for any device, and for tests of the compiled kernels."""
