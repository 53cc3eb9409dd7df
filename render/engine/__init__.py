"""Where arrays live and how they get their random numbers: backend, variant, Philox, Poisson, streams."""
