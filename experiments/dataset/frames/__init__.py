"""One frame and its truth, made from configuration and frame number: attitude, sky, light, header."""
