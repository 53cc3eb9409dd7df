"""Frames of a laboratory's own camera, reduced as the tests with point targets reduce rendered ones (``--frames``)."""
