"""Mitsuba plugins: `star_field`, `lens_camera`, `star_tracer`, `lunar_surface`, and their registration."""
