"""Star catalogues: the record, readers, space motion, temperatures, the index on the sphere."""
