"""Many frames: who makes which, the folder they go to, and taking up again what was interrupted."""
