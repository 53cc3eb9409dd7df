"""Where arrays live and how they get their random numbers: the engine, its array types, Philox, Poisson, streams."""

from render.engine.engine import Engine

__all__ = ["Engine"]
