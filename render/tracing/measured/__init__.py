"""Images of stars through a lens that was measured: places and Gaussians in place of traced rays."""
