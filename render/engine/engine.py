"""The backend of Dr.Jit and Mitsuba: one record, chosen once per process.

The choice belongs to the process, like Mitsuba's variant. `Engine.start` makes it after a check of the machine;
computing code calls `Engine.active`.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, ClassVar

from optics.errors import BackendError
from render.engine.llvm import check_llvm

if TYPE_CHECKING:
    from render.engine.arrays import DrJitArrays


BACKENDS = ("auto", "llvm", "cuda")
_SUFFIX = "ad_mono"


@dataclass(frozen=True, slots=True)
class Engine:
    """A Dr.Jit backend with its Mitsuba variant; `start` creates it, `active` returns it.

    Attributes
    ----------
    backend : {"llvm", "cuda"}
        ``llvm`` runs on the processor, ``cuda`` on an NVIDIA GPU.
    suffix : str
        Rest of the name of Mitsuba's variant, e.g. ``"ad_mono"``, ``"ad_spectral"``, ``"ad_rgb"``.

    Examples
    --------
    >>> engine = Engine.start("llvm")
    >>> engine.types.Float64([1.0, 2.0]) + 1.0
    [2, 3]
    """

    backend: str
    suffix: str = _SUFFIX

    _started: ClassVar[Engine | None] = None

    @staticmethod
    def start(backend: str = "auto", *, suffix: str = _SUFFIX) -> Engine:
        """Choose where to compute, after a check that it works here; does nothing when that is active already.

        Parameters
        ----------
        backend : {"auto", "llvm", "cuda"}
            ``auto`` keeps what is active already, otherwise it takes the GPU if there is one.
        suffix : str
            Rest of the variant's name.

        Returns
        -------
        Engine

        Raises
        ------
        BackendError
            LLVM or CUDA is missing, LLVM is too old or known to abort with the installed Dr.Jit, or there is no such
            backend (or variant, where Mitsuba is loaded already).

        Notes
        -----
        Plugins are registered per variant: `render.plugins.register.register_plugins` again when it changes.
        """
        active = _of_variant(_variant()) or Engine._started
        if backend == "auto" and active is not None and active.suffix == suffix:
            return active
        engine = Engine(_usable(backend), suffix)
        if "mitsuba" in sys.modules:
            _ = engine.mitsuba  # sets the variant
        Engine._started = engine
        return engine

    @staticmethod
    def active() -> Engine:
        """Engine of this process: that of Mitsuba's variant if one is set, else the one started, else ``start()``.

        Raises
        ------
        BackendError
            Mitsuba's variant is one without Dr.Jit arrays; or as `start`.
        """
        variant = _variant()
        if variant is None:
            return Engine._started or Engine.start()
        engine = _of_variant(variant)
        if engine is None:
            raise BackendError(f"Mitsuba variant {variant} is active; call render.engine.Engine.start('auto') first")
        return engine

    @property
    def variant(self) -> str:
        """Name of Mitsuba's variant, e.g. ``"llvm_ad_mono"``."""
        return f"{self.backend}_{self.suffix}"

    @property
    def types(self) -> Any:
        """Module of Dr.Jit's array types without derivatives: ``drjit.llvm`` or ``drjit.cuda``."""
        return importlib.import_module(f"drjit.{self.backend}")

    @property
    def arrays(self) -> DrJitArrays:
        """Array functions of the ray trace (`optics.arrays.ArrayNamespace`) in float64."""
        from render.engine.arrays import DrJitArrays

        return DrJitArrays(self.types.Float64)

    @property
    def mitsuba(self) -> Any:
        """Mitsuba with this engine's variant set; imported on first use, for arrays alone do not need it.

        Raises
        ------
        BackendError
            Mitsuba is not installed or has no such variant.
        """
        try:
            mi = importlib.import_module("mitsuba")
        except ImportError as error:
            reason = (str(error).splitlines() or ["no reason given"])[0]
            raise BackendError(f"Mitsuba cannot be loaded ({reason}); pip install 'mitsuba==3.9.0'") from None
        if mi.variant() != self.variant:
            if self.variant not in mi.variants():
                variants = ", ".join(sorted(name for name in mi.variants() if name.startswith(self.backend)))
                raise BackendError(f"Mitsuba has no variant {self.variant!r}; it has {variants}")
            mi.set_variant(self.variant)
        return mi


def _variant() -> str | None:
    """Mitsuba's variant, None while Mitsuba is not loaded or has none."""
    return sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None


def _of_variant(variant: str | None) -> Engine | None:
    """Engine of a variant; None for scalar variants."""
    backend, _, suffix = (variant or "").partition("_")
    return Engine(backend, suffix) if backend in BACKENDS else None


def _usable(backend: str) -> str:
    """``llvm`` or ``cuda``, as requested, after a check that it works here; ``drjit.llvm`` can be imported then."""
    if backend not in BACKENDS:
        raise BackendError(f"backend = {backend!r} does not exist; choose one of {', '.join(BACKENDS)}")
    from render.engine.jit import STDERR, dr

    has_gpu = bool(dr.has_backend(dr.JitBackend.CUDA))
    if backend == "cuda" and not has_gpu:
        raise BackendError("backend 'cuda' is not available: no NVIDIA GPU or driver was found; use backend 'llvm'")
    if backend == "cuda" or (backend == "auto" and has_gpu):
        return "cuda"
    check_llvm(dr.detail.llvm_version(), version("drjit"), printed=STDERR)
    return "llvm"
