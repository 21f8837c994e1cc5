"""SPL: splits, and what leaks through them."""
