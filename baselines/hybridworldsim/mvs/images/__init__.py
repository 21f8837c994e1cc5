"""Which pictures there are, and which are matched with each other."""
