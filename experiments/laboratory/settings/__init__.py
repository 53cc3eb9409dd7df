"""Settings of the laboratory, as tables of a configuration and of the sensor file; light to import."""
