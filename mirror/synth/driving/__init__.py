"""Who moves in the street, and how: lines along lanes, traffic that is simulated ahead of time, signals."""
