"""Twelve policies of spread skill on the suite `closed-loop`, with intervals of their ranks."""
