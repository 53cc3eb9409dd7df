"""The least-squares core: block-arrow equations, robust losses, solutions."""
