"""Extended bodies: positions and brightness of the Moon, planets and sunlit meshes."""
