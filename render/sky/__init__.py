"""From the sky to light at the lens: star fields, sunlight, zodiacal light, diffuse background."""
