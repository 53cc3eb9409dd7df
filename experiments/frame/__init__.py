"""Any frame as a page to zoom into, with the stars in it: ``starbench frame``."""
