"""The door: what of a dataset may leave the house, and the test of what is about to.

Publishing, releases and exports share it. `files` lists what a dataset's documents and tables name; `plan` divides that
into what may leave and what must not, by traversal, camera and time; `placing` copies one file so that its bytes are
those of its source; `inspection` hashes what was written, with all that containers and pages hold (`contents`), and
holds it against what must not leave (`secrets`). Whoever seals a folder calls `inspection` last.
"""
