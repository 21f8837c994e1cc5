"""Road users: bodies of vehicles and people, and where they are at any time."""
