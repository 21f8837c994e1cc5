"""The folder of a run: its settings, its progress and its state."""
