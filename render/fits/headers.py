"""Text of FITS headers, card by card.

`astropy.io.fits.Header` builds a hundred cards in milliseconds, more than a small image takes to be written. Here a
card is formatted by astropy once and remembered: from one frame to the next most cards do not change.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np
from astropy.io import fits

from optics.errors import ConfigError

__all__ = ["Card", "block", "checked_cards"]

Card = tuple[str, Any, str]
"""Keyword, value, comment."""

BLOCK = 2880
"""Bytes of a FITS block (FITS standard 4.0, sec. 3.1)."""

_MANY = ("COMMENT", "HISTORY", "")
_STRUCTURE = (
    "SIMPLE",
    "XTENSION",
    "BITPIX",
    "EXTEND",
    "END",
    "BZERO",
    "BSCALE",
    "PCOUNT",
    "GCOUNT",
    "CHECKSUM",
    "DATASUM",
)


def checked_cards(cards: Iterable[Card] | fits.Header, taken: Iterable[str]) -> list[Card]:
    """Cards of a caller as a list.

    Parameters
    ----------
    cards : iterable of (keyword, value, comment), or astropy.io.fits.Header
        What the caller gives.
    taken : iterable of str
        Keywords that are written anyway.

    Returns
    -------
    list of (keyword, value, comment)

    Raises
    ------
    ConfigError
        Not cards; a keyword that describes the file itself, is taken, or comes twice.
    """
    given: Iterable[Any] = cards.cards if isinstance(cards, fits.Header) else cards
    seen = set(taken)
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
            if name in seen:
                raise ConfigError(f"card {name} is there already; a keyword can stand once")
            seen.add(name)
        value = value.item() if isinstance(value, np.generic) else value
        if not isinstance(value, str | bool | int | float | None):
            raise ConfigError(f"card {name} = {value!r}; text, a number, a truth value or None is needed")
        checked.append((name, value, str(comment)))
    return checked


def block(cards: Iterable[Card]) -> bytes:
    """Header of the cards, with ``END``, filled up to whole blocks.

    Raises
    ------
    ConfigError
        A keyword or value that FITS cannot hold.
    """
    text = "".join(_image(*_plain(card)) for card in cards) + "END".ljust(80)
    return text.ljust(-(-len(text) // BLOCK) * BLOCK).encode("ascii")


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
