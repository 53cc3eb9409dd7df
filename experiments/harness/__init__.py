"""What makes a command of an experiment: configuration, output folder, progress, tables, figures, report."""
