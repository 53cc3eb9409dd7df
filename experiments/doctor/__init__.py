"""Whether this machine has what starbench needs, and what to do where it has not: ``starbench doctor``."""
