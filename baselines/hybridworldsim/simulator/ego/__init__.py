"""The ego vehicle: its motion under controls, and the tracker that turns a trajectory into controls."""
