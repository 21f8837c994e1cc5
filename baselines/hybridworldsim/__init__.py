"""HybridWorldSim, the model of the paper: static reconstruction, dynamic generation, closed-loop simulation."""
