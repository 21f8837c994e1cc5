"""What a benchmark asks for: protocols as data, the views that they ask for, and the truth of those views."""
