"""What is true of a frame: a row per star, a record per frame, and the files that hold them."""
