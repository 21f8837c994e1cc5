"""The comparison of methods of static reconstruction: declared, run as a queue, scored, tabulated."""
