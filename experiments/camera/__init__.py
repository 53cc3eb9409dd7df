"""Performance of your star sensor from its sensor file: predicted in seconds, confirmed by rendered frames."""
