"""GEO: places on the globe, and the world that hangs on them."""
