"""Lens files of other programs: readers, what became of every line, glasses by catalogue, writers."""
