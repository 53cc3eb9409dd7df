"""Star directions during an exposure."""
