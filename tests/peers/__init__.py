"""Other toolkits in environments of their own, and what they read of our files; `make peers` makes the results."""
