"""CAM: calibrations and rigs."""
