"""Round targets and points of a target: sub-pixel edges, circle fits and their noise, matching to nominal positions."""
