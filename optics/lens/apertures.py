"""Clear apertures and obscurations: circle, rectangle, ellipse, polygon, spider.

Outlines are stated in x and y of the surface's own frame, at the point where a ray meets the surface. Each is a record
whose fields are its keys in a lens file; `Aperture.inside` runs on every array library.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_, xor
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, FiniteFloat

from optics.arrays import ArrayNamespace, FloatArray
from optics.errors import DomainError
from optics.validate import Positive

Point = tuple[FiniteFloat, FiniteFloat]
ROUND_POINTS = 72


@dataclass(frozen=True, slots=True, kw_only=True)
class Aperture(ABC):
    """An outline in the frame of a surface."""

    obscures: bool = False  # False: light passes inside; True: light is blocked inside
    centre_mm: Point = (0.0, 0.0)  # (x, y) Centre
    angle_deg: FiniteFloat = 0.0  # Rotation about its centre, from x towards y
    kind: ClassVar[str]

    def parameters(self) -> tuple[float, ...]:
        """Numbers that `inside` reads: centre, cosine and sine of the rotation, then `outline_parameters`."""
        turn = math.radians(self.angle_deg)
        return (*self.centre_mm, math.cos(turn), math.sin(turn), *self.outline_parameters())

    @abstractmethod
    def outline_parameters(self) -> tuple[float, ...]:
        """Numbers that `within` reads."""

    @staticmethod
    @abstractmethod
    def within(p: Sequence[Any], u: Any, v: Any, xp: ArrayNamespace) -> Any:
        """Mask of the points (u, v) inside, in the frame of the outline; p are its `outline_parameters`."""

    @classmethod
    def inside(cls, p: Sequence[Any], x: Any, y: Any, xp: ArrayNamespace) -> Any:
        """Mask of the points of the surface [mm] inside the outline; p are its `parameters`."""
        u, v = x - p[0], y - p[1]
        return cls.within(p[4:], p[2] * u + p[3] * v, p[2] * v - p[3] * u, xp)

    @abstractmethod
    def local_outlines(self) -> list[FloatArray]:
        """Closed polygons (n, 2) [mm] that draw it, in the frame of the outline."""

    def outlines(self) -> list[FloatArray]:
        """Closed polygons (n, 2) [mm] that draw it, in x and y of the surface."""
        turn = math.radians(self.angle_deg)
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        return [points @ rotation.T + self.centre_mm for points in self.local_outlines()]

    def flipped(self) -> Self:
        """The outline seen from behind: x -> -x."""
        return replace(self, centre_mm=(-self.centre_mm[0], self.centre_mm[1]), angle_deg=-self.angle_deg)

    @abstractmethod
    def local_scaled(self, factor: float) -> Self:
        """The outline expanded about its centre."""

    def scaled(self, factor: float) -> Self:
        """The outline expanded about the vertex."""
        x, y = self.centre_mm
        return replace(self.local_scaled(factor), centre_mm=(factor * x, factor * y))


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle(Aperture):
    """Disk of ``radius_mm``."""

    radius_mm: Positive
    kind: ClassVar[str] = "circle"

    def outline_parameters(self) -> tuple[float, ...]:
        """Square of the radius [mm^2]."""
        return (self.radius_mm**2,)

    @staticmethod
    def within(p: Sequence[Any], u: Any, v: Any, xp: ArrayNamespace) -> Any:
        return u * u + v * v <= p[0]

    def local_outlines(self) -> list[FloatArray]:
        return [self.radius_mm * _circle()]

    def local_scaled(self, factor: float) -> Self:
        return replace(self, radius_mm=factor * self.radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ellipse(Aperture):
    """Ellipse with semi-axes ``half_width_mm``."""

    half_width_mm: tuple[Positive, Positive]
    kind: ClassVar[str] = "ellipse"

    def outline_parameters(self) -> tuple[float, ...]:
        """Squares of the reciprocal semi-axes [mm^-2]."""
        return (self.half_width_mm[0] ** -2, self.half_width_mm[1] ** -2)

    @staticmethod
    def within(p: Sequence[Any], u: Any, v: Any, xp: ArrayNamespace) -> Any:
        return p[0] * u * u + p[1] * v * v <= 1.0

    def local_outlines(self) -> list[FloatArray]:
        return [_circle() * self.half_width_mm]

    def local_scaled(self, factor: float) -> Self:
        return replace(self, half_width_mm=(factor * self.half_width_mm[0], factor * self.half_width_mm[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Rectangle(Aperture):
    """Rectangle of twice ``half_width_mm``."""

    half_width_mm: tuple[Positive, Positive]
    kind: ClassVar[str] = "rectangle"

    def outline_parameters(self) -> tuple[float, ...]:
        """Squares of the half widths [mm^2]."""
        return (self.half_width_mm[0] ** 2, self.half_width_mm[1] ** 2)

    @staticmethod
    def within(p: Sequence[Any], u: Any, v: Any, xp: ArrayNamespace) -> Any:
        return (u * u <= p[0]) & (v * v <= p[1])

    def local_outlines(self) -> list[FloatArray]:
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
        return [corners * self.half_width_mm]

    def local_scaled(self, factor: float) -> Self:
        return replace(self, half_width_mm=(factor * self.half_width_mm[0], factor * self.half_width_mm[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Polygon(Aperture):
    """Polygon with corners ``points_mm``, convex or not; it must not cross itself."""

    points_mm: Annotated[tuple[Point, ...], Field(min_length=3)]
    kind: ClassVar[str] = "polygon"

    def __post_init__(self) -> None:
        x, y = np.array(self.points_mm, float).T
        if not abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0.0:
            raise DomainError("Polygon.points_mm: the corners lie on one line; they enclose no area")

    def outline_parameters(self) -> tuple[float, ...]:
        """Coordinates of the corners [mm]."""
        return tuple(value for point in self.points_mm for value in point)

    @staticmethod
    def within(p: Sequence[Any], u: Any, v: Any, xp: ArrayNamespace) -> Any:
        """Mask of the points inside: a ray towards +u crosses the outline an odd number of times."""
        corners = [(p[i], p[i + 1]) for i in range(0, len(p), 2)]
        crossed = []
        for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
            between = (ay > v) != (by > v)
            rise = by - ay
            side = (u - ax) * rise - (v - ay) * (bx - ax)
            crossed.append(between & xor(side > 0.0, rise > 0.0))
        return reduce(xor, crossed)

    def local_outlines(self) -> list[FloatArray]:
        return [np.array([*self.points_mm, self.points_mm[0]], float)]

    def flipped(self) -> Self:
        return replace(Aperture.flipped(self), points_mm=tuple((-x, y) for x, y in self.points_mm))

    def local_scaled(self, factor: float) -> Self:
        return replace(self, points_mm=tuple((factor * x, factor * y) for x, y in self.points_mm))


@dataclass(frozen=True, slots=True, kw_only=True)
class Spider(Aperture):
    """Vanes of ``width_mm``: ``arms`` half-lines from the centre, evenly turned, the first along +x; it obscures."""

    obscures: bool = True
    arms: Annotated[int, Field(ge=1, le=32)]
    width_mm: Positive
    kind: ClassVar[str] = "spider"

    def __post_init__(self) -> None:
        if not self.obscures:
            raise DomainError("Spider.obscures = False; a spider can only block light")

    def outline_parameters(self) -> tuple[float, ...]:
        """Half width [mm], then cosine and sine of every arm."""
        turns = 2.0 * np.pi * np.arange(self.arms) / self.arms
        return (0.5 * self.width_mm, *(f(t) for t in turns.tolist() for f in (math.cos, math.sin)))

    @staticmethod
    def within(p: Sequence[Any], u: Any, v: Any, xp: ArrayNamespace) -> Any:
        half, on_arm = p[0], []
        for i in range(1, len(p), 2):
            along, across = p[i] * u + p[i + 1] * v, p[i] * v - p[i + 1] * u
            on_arm.append((along >= 0.0) & (across <= half) & (across >= -half))
        return reduce(or_, on_arm)

    def local_outlines(self) -> list[FloatArray]:
        """Centre lines of the vanes, drawn with unit length."""
        turns = 2.0 * np.pi * np.arange(self.arms) / self.arms
        return [np.array([[0.0, 0.0], [math.cos(t), math.sin(t)]]) for t in turns.tolist()]

    def flipped(self) -> Self:
        """The vanes seen from behind: an arm along +x then points along -x."""
        return replace(Aperture.flipped(self), angle_deg=180.0 - self.angle_deg)

    def local_scaled(self, factor: float) -> Self:
        return replace(self, width_mm=factor * self.width_mm)


def _circle() -> FloatArray:
    turn = np.linspace(0.0, 2.0 * np.pi, ROUND_POINTS + 1)
    return np.column_stack([np.cos(turn), np.sin(turn)])


APERTURES: tuple[type[Aperture], ...] = (Circle, Ellipse, Rectangle, Polygon, Spider)
"""The kinds of aperture that lens files may name."""
