"""Frames of one's own camera, reduced as the tests with point targets reduce rendered ones (``--own-frames``)."""
