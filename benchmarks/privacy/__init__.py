"""De-identification: recall of faces and plates, what is covered beside them, the template attack, and run time."""
