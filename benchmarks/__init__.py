"""Benchmarks that measure run time and error together, for MIRROR and for its peers."""
