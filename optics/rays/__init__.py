"""Rays through a lens: compiled program, sequential trace, pupil, chief rays, spots, paraxial optics, reversal."""
