"""The least-squares core: block-arrow equations, robust losses, what a fit gives back."""
