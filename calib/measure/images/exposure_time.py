"""When a frame was exposed, in UTC: cards of FITS headers, tags of EXIF and TIFF, names of files.

Meaning of the cards: FITS standard 4.0, sec. 9 (DATE-OBS, DATE-BEG, DATE-AVG, DATE-END, MJD-*, TIMESYS); EXIF 3.0,
sec. 4.6.6 (DateTimeOriginal, OffsetTimeOriginal, SubSecTimeOriginal). DATE of a FITS file is the time of its writing.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from datetime import time as time_of_day
from typing import Any

from calib.records import ExposureTime

_YEARS = range(1900, 2101)  # Unset clocks and counters give others
_CLOCKS = (
    "TIME-OBS", "TIME-BEG", "UTSTART", "UT-START", "START-UT", "UTC-BEG", "UTCSTART", "UTC-STRT", "UTC-OBS", "UT-OBS",
    "UTOBS", "UTC", "UT", "UTIME", "UT-TIME", "TIMEOBS", "OBS-TIME", "TIME",
)  # fmt: skip
"""Cards with the time of day of a start, in a header where DATE-OBS or UT-DATE is a date."""
_DAYS = ("DATE-BEG", "DATE-OBS", "DATEOBS", "UT-DATE", "UTC-DATE", "OBS-DATE")
_MIDNIGHT = time_of_day(0)  # Some programs write it where a card of its own has the time of day
_JULIAN = {"MJD": 0.0, "JD": 2400000.5}
_SCALES = {
    "UTC": "utc", "UT": "utc", "UT1": "utc", "GMT": "utc", "Z": "utc", "TAI": "tai", "IAT": "tai", "TT": "tt",
    "TDT": "tt", "ET": "tt", "TDB": "tdb", "TCG": "tcg", "TCB": "tcb", "GPS": "gps",
}  # fmt: skip
"""Time scales of TIMESYS as astropy names them; UT1 differs from UTC by less than 0.9 s."""
_GPS_BEHIND_TAI_S = 19.0
_CLOCK = re.compile(r"(\d{1,2})[:h ]\s*(\d{1,2})(?:[:m ]\s*(\d{1,2}(?:\.\d*)?))?\s*s?\s*(Z|[-+]\d{2}:?\d{2})?$")
_OLD_DAY = re.compile(r"(\d{2})/(\d{2})/(\d{2}|\d{4})$")
_NAME = re.compile(
    r"(?<!\d)(\d{4})[-_.]?(\d{2})[-_.]?(\d{2})[T_ -]?(\d{2})[-:_h]?(\d{2})[-:_m]?(\d{2})\.?(\d+)?s?"
    r"(?:[_ -]?(UTC|GMT|UT|Z)(?![A-Za-z])|(\+\d{2}:?\d{2}|-\d{2}:\d{2}))?"
)


def header_time(header: Mapping[str, Any], exposure_s: float | None = None) -> ExposureTime | None:
    """Middle of the exposure by the cards of a FITS header: stated, by start and exposure time, start and end, or end.

    Parameters
    ----------
    header : mapping
        Cards; letters of either case, ``_`` for ``-``.
    exposure_s : float, optional
        Exposure time.

    Returns
    -------
    ExposureTime or None
        Without a zone or TIMESYS in the header it is UTC, by the standard. None: no date with a time of day.
    """
    cards = {str(key).upper().replace("_", "-"): value for key, value in header.items()}
    scale = str(cards.get("TIMESYS") or "UTC").strip().upper()
    scale = re.split(r"[^A-Z0-9]", scale)[0]
    middle = _instant(cards, ("DATE-AVG", "DATE-MID"), ("MJD-AVG", "MJD-MID"), scale)
    if middle is not None:
        return middle
    start = _instant(cards, _DAYS, ("MJD-BEG", "MJD-OBS", "JD-OBS", "MJD", "JD"), scale)
    end = _instant(cards, ("DATE-END",), ("MJD-END",), scale)
    if start is not None:
        if not exposure_s and end is not None and end.utc > start.utc:
            return replace(start, utc=start.utc + (end.utc - start.utc) / 2, source=f"{start.source}, {end.source}")
        return _later(start, exposure_s)
    return None if end is None else _later(end, -exposure_s if exposure_s else None)


def exif_time(tags: Mapping[str, Any], exposure_s: float | None = None) -> ExposureTime | None:
    """Middle of the exposure by EXIF or TIFF tags (name -> value).

    Without an OffsetTime tag, a GPS time within 15 h sets the zone, to a quarter of an hour.
    """
    names = {key.lower(): str(value).strip("\0 ") for key, value in tags.items()}
    for suffix in ("Original", "Digitized", ""):
        text = names.get(f"datetime{suffix.lower()}", "")
        day, _, clock = text.partition(" ")
        part = names.get(f"subsectime{suffix.lower()}", "")
        offset = next((names[key] for key in (f"offsettime{suffix.lower()}", "offsettime") if names.get(key)), "")
        fraction = f".{part}" if part.isdecimal() and "." not in clock else ""
        local = _parsed(f"{day.replace(':', '-')} {clock}{fraction}")
        if local is None:
            continue
        source = f"DateTime{suffix}"
        aware = _parsed(f"{local.isoformat()}{offset}") if offset and local.tzinfo is None else local
        if aware is not None and aware.tzinfo is not None:
            return _later(ExposureTime(utc=aware.astimezone(UTC), source=source, zone_stated=True), exposure_s)
        utc, gps = local.replace(tzinfo=UTC), _gps(tags)
        if gps is not None and abs(gps - utc) < timedelta(hours=15):
            quarters = round((utc - gps) / timedelta(minutes=15))
            utc, source = utc - quarters * timedelta(minutes=15), f"{source} in the zone of GPSTimeStamp"
        else:
            gps = None
        return _later(ExposureTime(utc=utc, source=source, zone_stated=gps is not None), exposure_s)
    return None


def name_time(name: str, exposure_s: float | None = None) -> ExposureTime | None:
    """Middle of the exposure by a file name such as ``2019-07-29T204726``: year, month, day, hour, minute, second.

    A zone is ``Z``, ``UTC`` or ``+0200`` behind the seconds; without it the time is read as UTC.
    """
    for match in _NAME.finditer(name):
        year, month, day, hour, minute, second, fraction, utc, offset = match.groups()
        text = f"{year}-{month}-{day}T{hour}:{minute}:{second}.{fraction or 0}{'Z' if utc else offset or ''}"
        time = _parsed(text)
        if time is not None:
            stated = time.tzinfo is not None
            time = time.astimezone(UTC) if stated else time.replace(tzinfo=UTC)
            return _later(ExposureTime(utc=time, source="file name", zone_stated=stated), exposure_s)
    return None


def _later(time: ExposureTime, exposure_s: float | None) -> ExposureTime:
    if not exposure_s:
        return time
    sign = "-" if exposure_s < 0 else "+"
    source = f"{time.source} {sign} half the exposure"
    return replace(time, utc=time.utc + timedelta(seconds=0.5 * exposure_s), source=source)


def _instant(cards: Mapping[str, Any], dates: Iterable[str], numbers: Iterable[str], scale: str) -> ExposureTime | None:
    """First of the dates with a time of day, else of the Julian dates."""
    for card in dates:
        text = str(cards.get(card) or "").strip()
        time, source = _parsed(text), card
        day = _is_day(text)
        if day or time is None or time.time() == _MIDNIGHT:
            clocks = () if card in ("DATE-AVG", "DATE-MID", "DATE-END") else _CLOCKS
            dated = ((_with_clock(time, cards.get(clock)), clock) for clock in clocks)
            combined, clock = next(((value, clock) for value, clock in dated if value is not None), (None, ""))
            if combined is not None:
                time, source = combined, f"{card} + {clock}" if text else clock
            elif day:
                time = None
        if time is not None:
            return _in_utc(time, scale, source)
    for card in numbers:
        try:
            days = float(cards[card]) - _JULIAN["MJD" if card.startswith("MJD") else "JD"]
            time = datetime(1858, 11, 17) + timedelta(days=days)
        except (KeyError, TypeError, ValueError, OverflowError):
            continue
        if time.year in _YEARS:
            return _in_utc(time, scale, card)
    return None


def _is_day(text: str) -> bool:
    return len(text) <= len("2024-05-01") and "T" not in text


def _with_clock(day: datetime | None, clock: Any) -> datetime | None:
    """A day with a time of day: ``20:10:33.5``, hours, or seconds of the day; a whole date and time by itself."""
    if clock is None or isinstance(clock, bool):
        return None
    words = str(clock).strip()
    complete = None if _is_day(words) else _parsed(words)
    if complete is not None:
        return complete
    if day is None:
        return None
    match = _CLOCK.match(words)
    if match is not None:
        hour, minute, second, zone = match.groups()
        seconds = 3600 * int(hour) + 60 * int(minute) + float(second or 0.0)
    else:
        zone = None
        try:
            number = float(words)
        except ValueError:
            return None
        seconds = 3600.0 * number if number < 24.0 else number
    if not 0.0 <= seconds <= 86401.0:
        return None
    time = day + timedelta(seconds=seconds)
    return time if zone is None else _parsed(f"{time.isoformat()}{zone}")


def _parsed(text: str) -> datetime | None:
    """ISO 8601, with a zone or without, or the day of old FITS files (dd/mm/yy)."""
    text = text.strip()
    old = _OLD_DAY.match(text)
    if old is not None:
        day, month, year = old.groups()
        text = f"{year if len(year) == 4 else '19' + year}-{month}-{day}"
    text = re.sub(r"\s*(?:UTC|GMT|UT|Z)$", "Z", text.replace("/", "-"), flags=re.IGNORECASE)
    text = re.sub(r"(?<![\d.,])(\d)(?=[-:T +]|$)", r"0\1", re.sub(r" (?=[-+]\d)", "", text))
    leap = text[16:19] == ":60"
    try:
        time = datetime.fromisoformat(text.replace(":60", ":59", 1) if leap else re.sub(r"\.(?=$|Z|[-+])", "", text))
    except ValueError:
        return None
    return time + timedelta(seconds=float(leap)) if time.year in _YEARS else None


def _in_utc(time: datetime, scale: str, source: str) -> ExposureTime:
    """A time of a header; a zone that it states itself overrules TIMESYS."""
    if time.tzinfo is not None:
        return ExposureTime(utc=time.astimezone(UTC), source=source, zone_stated=True)
    if scale not in _SCALES:
        source = f"{source}, TIMESYS = {scale!r}"
        return ExposureTime(utc=time.replace(tzinfo=UTC), source=source, zone_stated=False)
    name = _SCALES[scale]
    if name != "utc":
        from astropy.time import Time  # slow to import

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of years before UTC
            behind = timedelta(seconds=_GPS_BEHIND_TAI_S if name == "gps" else 0.0)
            time = Time(time + behind, scale="tai" if name == "gps" else name).utc.to_datetime()
        source = f"{source} ({scale})"
    return ExposureTime(utc=time.replace(tzinfo=UTC), source=source, zone_stated=True)


def _gps(tags: Mapping[str, Any]) -> datetime | None:
    try:
        hour, minute, second = (float(number) for number in tags["GPSTimeStamp"])
        day = _parsed(str(tags["GPSDateStamp"]).strip("\0 ").replace(":", "-"))
        seconds = timedelta(hours=hour, minutes=minute, seconds=second)
        return None if day is None else day.replace(tzinfo=UTC) + seconds
    except (KeyError, TypeError, ValueError, OverflowError, ZeroDivisionError):
        return None
