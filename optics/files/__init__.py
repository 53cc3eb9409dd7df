"""Lens files of other programs: readers, a report on every line, glasses by catalogue."""
