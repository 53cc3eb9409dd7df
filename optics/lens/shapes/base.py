"""Interface of surface types, used by trace, lens files, tolerances and drawings.

A shape is a record. Its fields are its keys in a lens file and the quantities that tolerances change; its
`Shape.parameters` are the input of the trace. Its frame is that of its vertex: light travels towards +z, the vertex is
the origin, the sag is z(x, y). A shape is geometry only; refraction and reflection belong to the lens.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

from optics.arrays import ArrayNamespace, FloatArray
from optics.errors import DomainError


@dataclass(frozen=True, slots=True)
class Hit:
    """Intersection in the vertex frame: path from the vertex plane, point, unit normal towards +z, cosine, validity.

    ``valid`` is None where every ray is valid; a component that is zero for all rays may be a plain 0.0.
    """

    path: Any
    x: Any
    y: Any
    z: Any
    nx: Any
    ny: Any
    nz: Any
    cos_i: Any
    valid: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape(ABC):
    """A kind of surface.

    Subclasses are frozen, slotted, keyword-only dataclasses. The annotation of a field is also the check of its key in
    a lens file (``pydantic.FiniteFloat`` is a float to everybody else); what else must hold is in ``__post_init__``.

    Attributes
    ----------
    kind : str
        Name of the kind in lens files and messages.
    rotational : bool
        Whether the surface is one of revolution about its z axis; only then it has paraxial quantities.
    redirects : bool
        Whether it turns light by its own rule, `redirect`, in place of Snell's law.
    """

    kind: ClassVar[str]
    rotational: ClassVar[bool] = True
    redirects: ClassVar[bool] = False

    @property
    @abstractmethod
    def curvature(self) -> float:
        """Vertex curvature [1/mm]; the mean of the two principal ones if they differ."""

    @property
    def rim_mm(self) -> float:
        """Distance from the axis at which the surface ends, as a sphere does at its radius; infinite if it does not."""
        return math.inf

    def power(self, before: float, after: float, ambient: float) -> float:
        """Paraxial power [1/mm] between two refractive indices, in surroundings of a third one.

        Behind a mirror the second one counts negative.
        """
        return (after - before) * self.curvature

    @staticmethod
    def redirect(
        p: Sequence[Any], hit: Hit, d: Sequence[Any], index: tuple[Any, Any, Any], xp: ArrayNamespace
    ) -> tuple[tuple[Any, Any, Any], Any]:
        """Direction behind the surface and added optical path, for a type that `redirects`.

        ``index`` is that before it, behind it, and of the surroundings of the lens.
        """
        raise NotImplementedError

    @abstractmethod
    def parameters(self) -> tuple[float, ...]:
        """Numbers that `intersect` reads; as many for every shape of the kind that one compiled trace may serve."""

    @staticmethod
    @abstractmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        """Intersect rays that stand on the vertex plane; runs on every array library.

        Parameters
        ----------
        p : sequence
            `parameters`, as numbers or as arrays.
        x, y : array
            Where the rays cross z = 0 [mm].
        d : (dx, dy, dz)
            Unit directions, dz > 0.
        xp : ArrayNamespace
            Array library of the rays.
        """

    @abstractmethod
    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Sag z(x, y) [mm] on NumPy arrays; NaN where the surface does not reach. An oracle for `intersect`."""

    @abstractmethod
    def flipped(self) -> Self:
        """The surface seen from the image side, turned by 180 deg about y: z'(x, y) = -z(-x, y)."""

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """The surface expanded uniformly: z'(x, y) = factor z(x / factor, y / factor)."""

    def simplest(self) -> Shape:
        """The same surface as the type of least cost in the trace."""
        return self

    def changed(self, name: str, by: float) -> Shape:
        """The surface with ``by`` added to the field ``name``; another kind where this one cannot hold the result.

        Raises
        ------
        DomainError
            If it has no such number, or the result is not a surface of any kind.
        """
        numbers = [field.name for field in fields(self) if isinstance(getattr(self, field.name), int | float)]
        if name not in numbers:
            raise DomainError(
                f"a surface of kind {self.kind} has no {name}; it has {', '.join(numbers) or 'no parameter'}"
            )
        return replace(self, **{name: getattr(self, name) + by})


def require_finite(shape: Shape, *names: str) -> None:
    """Raise DomainError unless the fields, numbers or tuples of numbers, are finite."""
    for name in names:
        value = getattr(shape, name)
        items = (
            {f"{name}[{i}]": number for i, number in enumerate(value)} if isinstance(value, tuple) else {name: value}
        )
        for label, number in items.items():
            if not math.isfinite(number):
                raise DomainError(f"{type(shape).__name__}.{label} = {number}; a finite number is needed")


def require_positive(shape: Shape, *names: str) -> None:
    """Raise DomainError unless the fields are positive finite numbers."""
    for name in names:
        if not 0.0 < getattr(shape, name) < math.inf:
            raise DomainError(f"{type(shape).__name__}.{name} = {getattr(shape, name)}; a positive number is needed")
