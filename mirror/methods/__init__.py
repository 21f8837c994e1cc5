"""Methods as plug-ins: their interface, the registry of installed methods, training images and model documents."""
