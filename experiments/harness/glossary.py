"""Glossary of abbreviations, explained at their first use in a report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from markupsafe import Markup, escape


@dataclass(frozen=True, slots=True)
class Term:
    """Meaning of an abbreviation."""

    means: str  # One sentence
    link: str = ""  # Address of a page about it


_ECSS = "https://ecss.nl"
_EMVA = "https://www.emva.org/standards-technology/emva-1288/"
GLOSSARY: Mapping[str, Term] = {
    "ACC18": Term(
        "“Accuracy determination for sub-arcsec star camera”, Infrared and Laser Engineering 47(9), 0917002 (2018): "
        "TE, HSFE and LSFE of a star camera in the laboratory"
    ),
    "ACF17": Term(
        "“A star sensor calibration method based on attitude correlated frame”, Acta Optica Sinica 37(11), 1128003 "
        "(2017)"
    ),
    "CUBE09": Term(
        "“Calibration of transform matrix between sun sensor measurement and cubic prism coordinate systems”, "
        "Optics and Precision Engineering 17(4), 849 (2009)"
    ),
    "FISHER23": Term("a patent of 2023 on the laboratory evaluation of star vectors by the Fisher distribution"),
    "TE": Term("temporal error: noise from frame to frame of a star that stands still", _ECSS),
    "HSFE": Term(
        "high spatial frequency error: repeats from pixel to pixel (response of the pixels, shape of the centroider's "
        "answer within a pixel)",
        _ECSS,
    ),
    "LSFE": Term(
        "low spatial frequency error: changes slowly over the field (distortion, colour, calibration, temperature)",
        _ECSS,
    ),
    "NEA": Term("noise equivalent angle: standard deviation of a star's direction per axis from noise alone", _ECSS),
    "ePSF": Term("effective point spread function: the image of a star integrated over pixels, for fits"),
    "PSF": Term("point spread function: the image of a star"),
    "PRNU": Term("photo response non-uniformity: how much the response differs from pixel to pixel", _EMVA),
    "DSNU": Term("dark signal non-uniformity: how much the offset differs from pixel to pixel", _EMVA),
    "ACC": Term("calibration by attitude-correlated frames: a gyro links the attitudes of the frames (ACF17)"),
    "IAC": Term("calibration by interstar angles, which need no attitude (ACF17)"),
    "EMVA 1288": Term("standard for the description of image sensors and cameras", _EMVA),
}
_UNMARKED = frozenset(("code", "pre", "svg", "a", "h1", "h2", "h3", "th", "script", "style", "title", "math"))
_TAG = re.compile(r"(<[^>]+>)")
_NAME = re.compile(r"</?([A-Za-z0-9]+)")


class Glossary:
    """Marks terms of one page at their first use, and lists them."""

    def __init__(self, terms: Mapping[str, Term] = GLOSSARY) -> None:
        self.terms = terms
        self.used: dict[str, Term] = {}
        longest_first = sorted(terms, key=len, reverse=True)
        self._any = re.compile(rf"(?<![\w-])({'|'.join(map(re.escape, longest_first))})(?!\w)")

    def mark(self, html: str) -> Markup:
        """HTML whose terms link to their explanation at their first use, except in code and headings."""
        depth = 0  # of elements without marks
        parts = _TAG.split(html)  # text and tags in turn
        for number, part in enumerate(parts):
            if number % 2:
                name = _NAME.match(part)
                if name and name[1].lower() in _UNMARKED and not part.endswith("/>"):
                    depth += -1 if part.startswith("</") else 1
            elif not depth:
                parts[number] = self._any.sub(self._first, part)
        return Markup("".join(parts))

    def _first(self, match: re.Match[str]) -> str:
        word = match[1]
        if word in self.used:
            return word
        self.used[word] = self.terms[word]
        means = escape(self.terms[word].means)
        return f'<a class="term" href="#{self.anchor(word)}"><abbr title="{means}">{word}</abbr></a>'

    @staticmethod
    def anchor(word: str) -> str:
        """Anchor of a term in the list."""
        return "term-" + re.sub(r"\W+", "-", word)
