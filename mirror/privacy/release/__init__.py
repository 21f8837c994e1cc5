"""Releases of de-identified datasets: building, checking, reviewing and withdrawing."""
