"""Completion of the command ``starbench`` in bash, zsh and fish: ``starbench completion``."""
