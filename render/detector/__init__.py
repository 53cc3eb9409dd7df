"""The detector: its data sheet, the signal chain, patterns, diffusion, radiation, cosmic rays."""
