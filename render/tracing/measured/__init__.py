"""Images of stars through a measured lens: positions and Gaussians in place of traced rays."""
