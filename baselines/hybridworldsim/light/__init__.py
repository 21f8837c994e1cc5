"""Light of a recording: the response, exposure and noise of its cameras, and the headlights of the vehicle."""
