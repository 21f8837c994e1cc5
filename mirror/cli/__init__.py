"""The command line: one file a verb, thin, each with ``main(argv) -> exit code``."""
