"""Motion along ways: following, yielding, signals, and the simulation of all participants."""
