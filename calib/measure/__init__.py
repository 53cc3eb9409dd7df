"""From pixels to stars: background, detection, stamps, centroiders, their bound, circles."""
