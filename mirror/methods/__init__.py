"""Methods as plug-ins: the protocol that they follow, how installed ones are found, and what they are given."""
