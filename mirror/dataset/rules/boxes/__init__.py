"""BOX: 3D boxes; MSK: masks."""
