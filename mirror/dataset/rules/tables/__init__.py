"""TAB: every table against its schema."""
