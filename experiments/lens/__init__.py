"""What a lens file holds, as one page, and lens files turned into one another: ``starbench lens``."""
