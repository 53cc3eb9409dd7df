"""Lens files: a page on their contents, and conversion between formats (``starbench lens``)."""
