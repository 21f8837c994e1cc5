"""Images and grains that cover surfaces, made from seeds and filtered for any distance."""
