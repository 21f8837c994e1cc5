"""Number plates of many countries: synthetic ones with exact corners, recall of the detectors, and their training."""
