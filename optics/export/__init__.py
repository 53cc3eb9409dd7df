"""Writers of lens files: TOML, Zemax (.zmx), CODE V (.seq), and an AGF catalogue of glasses that those programs lack."""
