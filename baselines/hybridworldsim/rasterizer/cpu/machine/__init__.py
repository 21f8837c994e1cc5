"""How kernels run: compiled, by vectors, in threads, in memory that is used again."""
