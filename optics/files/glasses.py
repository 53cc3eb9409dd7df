"""Glass assignment in lens files: catalogues in the order of the file; every substitution is reported."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from optics.errors import ConfigError, StarbenchError
from optics.files.parsed_file import GlassName, ParsedFile
from optics.files.report import GlassChoice, Status
from optics.glass.agf import AgfCatalogue, read_agf
from optics.glass.catalogue import Glass, get_glass, list_glasses
from optics.glass.index_database import read_material
from optics.glass.model_glass import D_NM, MODEL_ERROR, glass_code, model_glass

BUILT_IN = {
    "SCHOTT": ("SCHOTT",),
    "OHARA": ("OHARA",),
    "CDGM": ("CDGM",),
    "MISC": ("generic",),
    "INFRARED": ("generic",),
}
"""Catalogues of design programs, by their first word, and the makers of the built-in catalogue that replace them."""
SYNONYMS = {
    "SILICA": "fused-silica", "F_SILICA": "fused-silica", "FUSEDSILICA": "fused-silica", "FSILICA": "fused-silica",
    "QUARTZGLASS": "fused-silica", "CAF2": "CaF2", "BAF2": "BaF2", "MGF2": "MgF2", "ZNSE": "ZnSe", "ZNS": "ZnS",
    "PMMA": "PMMA", "ACRYLIC": "PMMA", "POLYCARB": "polycarbonate", "POLYSTYR": "polystyrene", "SAPPHIRE": "sapphire",
    "E48R": "Zeonex-E48R", "C7980": "fused-silica", "CAF2DAIMON20": "CaF2-Daimon",
}  # fmt: skip
"""Names of common materials in design programs; their formulas need not be the same."""
STATED_ND = 2e-4
"""Largest difference by rounding and melt of an index stated with a catalogue name."""


@dataclass(frozen=True, slots=True)
class AssignedGlass:
    """A glass for a name: the record, the choice for the report, and the glass that the file means if it differs."""

    glass: Glass
    choice: GlassChoice
    intended: Glass | None


def read_glass(path: Path, name: str) -> Glass:
    """Glass ``name`` of an AGF catalogue, or the one of a material file of refractiveindex.info; by the ending."""
    ending = path.suffix.lower()
    if ending == ".agf":
        return read_agf(path).glass(name)
    if ending in (".yml", ".yaml"):
        return read_material(path, name)
    raise ConfigError(f"{path}: a catalogue (.agf) or a material of refractiveindex.info (.yml) is needed")


def _bare(name: str) -> str:
    """Name without hyphens and the like, as CODE V writes it."""
    return re.sub(r"[^A-Z0-9]", "", name.upper())


@dataclass
class GlassFinder:
    """Finds the glasses of one file."""

    parsed: ParsedFile  # The file
    files: Sequence[Path] = ()  # AGF catalogues of the user; catalogues in the folder of the lens file are added
    # Name in the file -> name of the glass to take in its place, by the user's order
    replace: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def user_catalogues(self) -> dict[str, AgfCatalogue]:
        """The user's catalogues by name; an invalid one that is not requested is left out."""
        adjacent = sorted(p for p in self.parsed.path.parent.glob("*") if p.suffix.lower() == ".agf")[:40]
        catalogues: dict[str, AgfCatalogue] = {}
        for path in dict.fromkeys([*self.files, *adjacent]):
            try:
                catalogue = read_agf(path)
            except StarbenchError:
                if path in self.files:
                    raise
                continue
            catalogues.setdefault(catalogue.name, catalogue)
        return catalogues

    def find(self, asked: GlassName) -> AssignedGlass:
        """The glass named in a file."""
        name = asked.name.strip("'\"")
        wanted = {_bare(key): value for key, value in self.replace.items()}.get(_bare(name))
        intended = self._intended(asked, name)
        if wanted is not None:
            glass, where = self._by_name(GlassName(name=wanted, line=asked.line, command=""), wanted) or (None, "")
            if glass is None:
                raise self.parsed.fail(asked.line, f"glass {wanted!r}, given to replace {name!r}, is not known")
            return self._assigned(name, glass, f"{where}, substituted for {name} as requested", intended, exact=False)
        if asked.nd and (asked.model or not _bare(name).replace("BLANK", "")):
            return self._model(asked, name, asked.nd, asked.vd or 0.0)
        exact = self._by_name(asked, name)
        if exact is not None:
            return self._checked(asked, name, *exact, intended)
        code = glass_code(name)
        if code is not None:
            return self._model(asked, name, *code)
        return self._another(asked, name, intended)

    def _by_name(self, asked: GlassName, name: str) -> tuple[Glass, str] | None:
        """The glass of that name, in the listed catalogues first."""
        name, catalogue = self._split(name)
        order = [catalogue.upper(), *self.parsed.catalogues] if catalogue else self.parsed.catalogues
        private = self.parsed.private.get(name.upper())
        if private is not None:
            return private, "the file's own glass"
        for listed in order:
            user_catalogue = self.user_catalogues.get(listed)
            if user_catalogue and (glass := self._in(user_catalogue, name)):
                return glass, f"catalogue {listed}"
            makers = BUILT_IN.get(re.split(r"[^A-Z]", listed)[0], ())
            for candidate in self._built_in(name):
                if candidate.maker in makers:
                    return candidate, f"built-in, {candidate.maker}"
        for title, user_catalogue in self.user_catalogues.items():
            if title not in order and (glass := self._in(user_catalogue, name)):
                return glass, f"catalogue {title}, which the file does not list"
        for glass in self._built_in(name):
            outside = bool(order) and "" not in order
            note = ", which is none of the catalogues that the file lists" if outside else ""
            return glass, f"built-in, {glass.maker}{note}"
        return None

    def _split(self, name: str) -> tuple[str, str]:
        """Glass and catalogue of a name such as ``NBK7_SCHOTT``; both parts may have such marks of their own."""
        if self._anywhere(name) or "_" not in name:
            return name, ""
        marks = [at for at, letter in enumerate(name) if letter == "_"]
        pairs = [(name[:at], name[at + 1 :]) for at in reversed(marks)]
        listed = [pair for pair in pairs if pair[1].upper() in (*self.user_catalogues, *BUILT_IN) and pair[0]]
        return listed[-1] if listed else pairs[0]

    def _anywhere(self, name: str) -> bool:
        return bool(self._built_in(name)) or any(self._in(c, name) for c in self.user_catalogues.values())

    @staticmethod
    def _in(catalogue: AgfCatalogue, name: str) -> Glass | None:
        """Exact name, or without hyphens as CODE V writes it."""
        if name not in catalogue:
            near = [n for n in catalogue.names if _bare(n) == _bare(name)]
            if not near:
                return None
            name = near[0]
        return catalogue.glass(name)

    @staticmethod
    def _built_in(name: str) -> list[Glass]:
        bare = _bare(name)
        glasses = [get_glass(n) for n in _names_by_bare().get(bare, ())]
        synonym = SYNONYMS.get(name.upper()) or SYNONYMS.get(bare)
        if synonym and all(glass.name != synonym for glass in glasses):
            glasses.append(get_glass(synonym))
        return glasses

    def _checked(self, asked: GlassName, name: str, glass: Glass, where: str, intended: Glass | None) -> AssignedGlass:
        """A glass found by name, compared with the numbers in the file."""
        exact = "which" not in where and not any(asked.offset)
        synonym = _bare(glass.name) != _bare(self._split(name)[0]) and _bare(glass.name) != _bare(name)
        if synonym:
            where += f", as {glass.name}"
        elif any(asked.offset):
            where += f", without the melt offset of n_d {asked.offset[0]:+g}, v_d {asked.offset[1]:+g}"
            base = glass.nd or float(glass.dispersion.index(D_NM))
            vd = glass.vd or 0.0
            intended = model_glass(name, base + asked.offset[0], vd + asked.offset[1]) if vd else None
        if exact and not synonym:
            other = self._elsewhere(glass, name)
            stated = self._stated(asked, glass)
            return self._assigned(
                name, glass, where + other + stated, glass if not stated else intended, exact=not stated
            )
        return self._assigned(name, glass, where, intended or (None if synonym else glass), exact=False)

    def _stated(self, asked: GlassName, glass: Glass) -> str:
        """A remark where the coefficients do not give the index that catalogue or file states."""
        low, high = glass.range_nm
        if not low <= D_NM <= high:
            return ""
        computed = float(glass.index(D_NM))
        for what, value in (("its catalogue", glass.nd), ("the file", asked.nd)):
            if value and abs(computed - value) > STATED_ND:
                return f"; its coefficients give n_d = {computed:.5f}, {what} states {value:.5f}"
        return ""

    def _elsewhere(self, glass: Glass, name: str) -> str:
        """A remark where another catalogue has the same name with another index."""
        others = [c.glass(name) for c in self.user_catalogues.values() if name in c and c.name != glass.maker]
        others += [g for g in self._built_in(name) if g.maker != glass.maker and _bare(g.name) == _bare(name)]
        for other in others:
            wave = np.linspace(max(glass.range_nm[0], 450.0), min(glass.range_nm[1], 900.0), 5)
            if not (other.range_nm[0] <= wave[0] < wave[-1] <= other.range_nm[1]):
                continue
            change = float(np.abs(other.index(wave) - glass.index(wave)).max())
            if change > 1e-7:
                return f"; {other.maker} has a glass of this name too, its index differs by up to {change:.1e}"
        return ""

    def _intended(self, asked: GlassName, name: str) -> Glass | None:
        """Glass that the file means, where its numbers decide."""
        if asked.nd and asked.nd > 1.0:
            try:
                return model_glass(name, asked.nd, asked.vd or 0.0, partial=asked.partial)
            except StarbenchError:
                return None
        code = glass_code(name)
        return model_glass(name, *code) if code else None

    def _model(self, asked: GlassName, name: str, nd: float, vd: float) -> AssignedGlass:
        """A glass from n_d and v_d, with the difference from the glass of its name, if known."""
        shown = name if _bare(name).replace("BLANK", "") else f"model-{nd:.6g}-{vd:.5g}"
        try:
            glass = model_glass(shown, nd, vd, partial=asked.partial)
        except StarbenchError as error:
            raise self.parsed.fail(asked.line, str(error)) from None
        namesake = self._by_name(asked, name) if name and not glass_code(name) else None
        remark = ""
        if namesake is not None:
            change = float(glass.index(D_NM)) - float(namesake[0].dispersion.index(D_NM))
            remark = f"; the catalogue glass of this name has n_d {change:+.1e} from it"
        if vd == 0.0:
            return self._assigned(name, glass, "constant index, as the file states it" + remark, glass, exact=True)
        where = f"n_d, v_d and the normal dispersion (half of all glasses lie within {MODEL_ERROR:.1e} of it)"
        return self._assigned(name, glass, where + remark, None, exact=False)

    def _another(self, asked: GlassName, name: str, intended: Glass | None) -> AssignedGlass:
        """An obsolete SCHOTT glass is taken as its successor N-; anything else is refused."""
        base = self._split(name)[0]
        successor = self._built_in(f"N{_bare(base)}")
        if successor and _bare(base) and not base.upper().startswith("N-"):
            glass = successor[0]
            where = f"{glass.name}, its successor without lead and arsenic, is used"
            return self._assigned(name, glass, where, intended, exact=False)
        available = (c.names for c in self.user_catalogues.values())
        names = [*list_glasses(), *list_glasses(obsolete=True), *(name for group in available for name in group)]
        by_capitals = {name.upper(): name for name in names}
        near = [by_capitals[n] for n in difflib.get_close_matches(base.upper(), by_capitals, n=3, cutoff=0.6)]
        listed = ", ".join(self.parsed.catalogues) or "none"
        hint = f" (nearest names: {', '.join(near)})" if near else ""
        raise self.parsed.fail(
            asked.line,
            f"glass {name!r} is in no available catalogue{hint}; the file lists {listed}: put the AGF file into "
            "the folder of the lens file, or name a substitute glass",
        )

    def _assigned(self, name: str, glass: Glass, where: str, intended: Glass | None, *, exact: bool) -> AssignedGlass:
        waves = [wave for wave, _ in self.parsed.wavelengths]
        for wave in waves:
            low, high = glass.range_nm
            if not low <= wave <= high:
                raise ConfigError(
                    f"{self.parsed.report.file}: wavelength {wave:g} nm is outside {low:g} ... {high:g} nm, the range "
                    f"of glass {glass.name} ({where})"
                )
        index = tuple(float(glass.index(wave)) for wave in waves)
        change = None
        if not exact and intended is not None and intended is not glass:
            change = tuple(n - float(intended.dispersion.index(w)) for w, n in zip(waves, index, strict=True))
        elif exact:
            change = (0.0,) * len(waves)
        status = Status.TAKEN if exact else Status.APPROXIMATED
        choice = GlassChoice(
            asked=name,
            taken=glass.name,
            where=where,
            status=status,
            wavelength_nm=tuple(waves),
            index=index,
            change=change,
        )
        return AssignedGlass(glass=glass, choice=choice, intended=None if exact else intended)


@cache
def _names_by_bare() -> dict[str, list[str]]:
    names: dict[str, list[str]] = {}
    for name in (*list_glasses(), *list_glasses(obsolete=True)):
        names.setdefault(_bare(name), []).append(name)
    return names
