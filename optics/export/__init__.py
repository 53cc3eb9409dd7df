"""Writers of lens files: TOML, Zemax (.zmx), CODE V (.seq), AGF catalogues of glasses missing there."""
