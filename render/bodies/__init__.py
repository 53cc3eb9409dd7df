"""Extended bodies: the Moon, planets and sunlit meshes, where they are and how bright."""
