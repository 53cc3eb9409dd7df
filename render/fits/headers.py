"""Text of FITS headers, card by card.

`astropy.io.fits.Header` builds a hundred cards in milliseconds, longer than a small image takes to write. Here each
card is formatted once by astropy and cached, because most cards are the same in all frames.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np
from astropy.io import fits

from optics.errors import ConfigError

Card = tuple[str, Any, str]
"""Keyword, value, comment."""

BLOCK = 2880
"""Bytes of a FITS block (FITS standard 4.0, sec. 3.1)."""

_MANY = ("COMMENT", "HISTORY", "")
_STRUCTURE = frozenset(
    "SIMPLE XTENSION BITPIX EXTEND END BZERO BSCALE PCOUNT GCOUNT CHECKSUM DATASUM".split()  # noqa: SIM905
)


def checked_cards(cards: Iterable[Card] | fits.Header, taken: Iterable[str]) -> list[Card]:
    """Validated cards of the caller as a list."""
    given: Iterable[Any] = cards.cards if isinstance(cards, fits.Header) else cards
    keywords = set(taken)
    checked: list[Card] = []
    for card in given:
        try:
            keyword, value, comment = card
        except (TypeError, ValueError):
            raise ConfigError(f"card {card!r}; (keyword, value, comment) is needed") from None
        name = str(keyword).upper()
        if name in _STRUCTURE or name.startswith("NAXIS"):
            raise ConfigError(f"card {name} describes the file itself and is written by it; leave it out")
        if name not in _MANY:
            if name in keywords:
                raise ConfigError(f"card {name} exists already; a keyword must be unique")
            keywords.add(name)
        value = value.item() if isinstance(value, np.generic) else value
        if not isinstance(value, str | bool | int | float | None):
            raise ConfigError(f"card {name} = {value!r}; text, a number, a truth value or None is needed")
        checked.append((name, value, str(comment)))
    return checked


def block(cards: Iterable[Card]) -> bytes:
    """Header of the cards, with ``END``, filled up to whole blocks."""
    text = "".join(_image(*_plain(card)) for card in cards) + "END".ljust(80)
    return text.ljust(-(-len(text) // BLOCK) * BLOCK).encode("ascii")


def summed(header: bytes, data: Any) -> bytes:
    """A header with its ``CHECKSUM`` and ``DATASUM`` (FITS standard 4.0, sec. 4.4.2.7 and appendix J)."""
    of_data = _ones_complement(data)
    written = header.replace(_DATASUM, str(of_data).ljust(_SUM_WIDTH).encode(), 1)
    total = _ones_complement(written, of_data)
    return written.replace(_CHECKSUM, _encoded(0xFFFFFFFF - total), 1)


_SUM_WIDTH = 16
_DATASUM, _CHECKSUM = b"D" * _SUM_WIDTH, b"0" * _SUM_WIDTH
SUMS: tuple[Card, ...] = (
    ("CHECKSUM", _CHECKSUM.decode(), "of header and data"),
    ("DATASUM", _DATASUM.decode(), "of the data"),
)
"""What `summed` fills in."""


def _ones_complement(content: Any, start: int = 0) -> int:
    """Sum of 32-bit words, most significant byte first, carries added at the low end; zeros follow the last byte."""
    view = memoryview(content).cast("B")
    full = len(view) // 4 * 4
    words = np.frombuffer(view[:full], np.uint32)
    if sys.byteorder == "little":
        words = words.byteswap()  # and sum what the machine counts in: a third of the time
    total = start + int(words.sum(dtype=np.uint64)) + int.from_bytes(bytes(view[full:]).ljust(4, b"\0"), "big")
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total


def _encoded(value: int) -> bytes:
    """Sixteen letters and digits that add up to a sum: every byte of it in four, none of them punctuation."""
    columns = []
    for byte in value.to_bytes(4, "big"):
        quarters = [byte // 4 + byte % 4 + ord("0"), *[byte // 4 + ord("0")] * 3]
        while not _PUNCTUATION.isdisjoint(quarters):
            for at in (0, 2):
                if not _PUNCTUATION.isdisjoint(quarters[at : at + 2]):
                    quarters[at] += 1
                    quarters[at + 1] -= 1
        columns.append(quarters)
    letters = bytes(column[row] for row in range(4) for column in columns)
    return letters[-1:] + letters[:-1]  # the value stands in columns 12 to 27 of its card


_PUNCTUATION = frozenset(b":;<=>?@[\\]^_`")


def _plain(card: Card) -> Card:
    keyword, value, comment = card
    # -0.0 and 0.0 are one key of the cache but two texts: what stands in a file must not depend on earlier ones
    return (keyword, value + 0.0, comment) if isinstance(value, float) else card


@lru_cache(maxsize=4096, typed=True)
def _image(keyword: str, value: Any, comment: str) -> str:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fits.verify.VerifyWarning)  # a comment too long for its card is cut
            text = str(fits.Card(keyword, value, comment).image)
        text.encode("ascii")
    except (ValueError, TypeError) as error:
        raise ConfigError(f"card {keyword} = {value!r} cannot be written ({str(error).splitlines()[0]})") from None
    return text
