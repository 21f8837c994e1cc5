"""Procedural textures: images and grains of surfaces, made from seeds and filtered for any distance."""
