"""What if: one or two keys of the sensor over a range, predicted at every value."""
