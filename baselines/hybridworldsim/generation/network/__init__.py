"""The transformer: its configuration, its blocks, its adapters, and the loading of released weights by key."""
