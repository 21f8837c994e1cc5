"""Road users that follow lanes, on synthetic and on recorded maps: lanes, following, placement."""
