"""Lenses as files: TOML, Zemax (.zmx), CODE V (.seq), and the AGF catalogue of glasses that those programs lack."""
