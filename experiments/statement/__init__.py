"""Performance of a star sensor as one document, clause by clause of ECSS-E-ST-60-20C."""
