"""The sensor file: tables that describe a star sensor (light to import), and the star sensor that they describe."""
