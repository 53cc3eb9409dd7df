"""Harness of the experiments: configuration, output folder, progress, tables, figures, report."""
