"""Images by diffraction: plane waves, their sums, and grids of images over the field."""
