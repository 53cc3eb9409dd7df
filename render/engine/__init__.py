"""The compute engine: array types, backends, random numbers (Philox, Poisson, named streams)."""

from render.engine.engine import Engine

__all__ = ["Engine"]
