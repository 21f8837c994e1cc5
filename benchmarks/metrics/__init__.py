"""Metrics: time against error, ours and the peers', in one run and on one thread."""
