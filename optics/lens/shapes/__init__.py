"""Types of surface, one file each: `registry` lists them, `base` is their interface."""
