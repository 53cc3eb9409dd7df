"""The budget without frames: every term predicted, in seconds."""
