"""How fast a block of a street is drawn and learnt, decode included, and how far that is from float64."""
