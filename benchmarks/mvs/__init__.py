"""Measures depth, ground and sky without networks against the synthetic street's exact truth."""
