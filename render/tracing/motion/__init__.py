"""Where stars are seen during an exposure."""
