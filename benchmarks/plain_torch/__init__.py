"""The torch forms that a GPU runs, on the CPU: steps at the paper's size, and trainings that end alike."""
