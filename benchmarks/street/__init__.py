"""Measures rendering and training of a street's block, and its error against float64."""
