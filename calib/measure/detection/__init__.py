"""Detection of stars: matched filter, false alarms, limiting magnitude, trails, footprints, scores against truth."""
