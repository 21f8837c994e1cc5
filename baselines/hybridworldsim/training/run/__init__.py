"""The folder of a run: what it was asked, how it went, and what it knows."""
