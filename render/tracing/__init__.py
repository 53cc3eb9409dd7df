"""Stars through the lens onto pixels: planning, pupil quadrature, kernel, passes, composition, truth."""
