"""Clauses of ECSS-E-ST-60-20C to which a statement refers, and clauses that it does not cover.

The wording is ours. Sources: the terms of Rev. 2 (15 May 2019) in the public glossary of ECSS, which names clauses
without numbers; the contents up to 4.1.6 of EN 16603-60-20:2020, which adopts Rev. 2; the clauses 3.2.8.2 to 3.2.8.4 of
Rev. 1 (15 November 2008). Numbers that were not read in a source are not stated.
"""

from __future__ import annotations

from dataclasses import dataclass

UNREAD = "number not read"


@dataclass(frozen=True, slots=True)
class Clause:
    """Term of the standard, and its clauses."""

    term: str
    clauses: str = UNREAD


CLAUSES = {
    "bias": Clause("Bias", "Rev. 2: term, contributors 5.5, angles B.5.17; Rev. 1: 3.2.8.2, metric MME B.5.7"),
    "thermo_elastic": Clause("Thermo-elastic error"),
    "fov_spatial": Clause("FOV spatial error", "Rev. 1: 3.2.8.3, metric MDE B.5.11"),
    "pixel_spatial": Clause("Pixel spatial error", "Rev. 2: term, contributors 5.5; Rev. 1: 3.2.8.4"),
    "temporal_noise": Clause("Temporal noise"),
    "aberration": Clause("Aberration of light"),
    "date": Clause("Measurement date error"),
    "bandwidth": Clause("Output bandwidth"),
    "total": Clause("Attitude error, all terms", "metrics: annex B"),
    "field": Clause("Half-rectangular field of view", "Rev. 2: term, Figure 3-9"),
    "false_star": Clause("False stars", "Rev. 2: term"),
    "detection": Clause("Detection of stars"),
    "acquisition": Clause("Autonomous attitude determination", "Rev. 2: 4.1.5"),
    "tracking": Clause("Autonomous attitude tracking", "Rev. 2: term, 4.1.6"),
}

NOT_COVERED = (
    ("Bias", "alignment on the ground and its change to flight are measured with the hardware", ""),
    ("Mechanical launch and settling effects", "not modelled", ""),
    ("Measurement date error", "time stamps come from the electronics", ""),
    ("Robustness to solar events", "not modelled", ""),
    ("Functional interfaces, commands and telemetry", "outside the scope of an optical simulation", ""),
    (
        "Verification by test",
        "needs frames of the hardware, which `starbench reduce` reduces, and a night sky test",
        "",
    ),
    ("Radiation, begin and end of life", "needs a flight run", "flight"),
    ("Sun, Earth and Moon near the field of view", "needs a flight run", "flight"),
    ("Lost in space: probability and time of acquisition, wrong attitudes", "needs a flight run", "flight"),
    ("Thermo-elastic error over an orbit, aberration residual", "needs a flight run", "flight"),
)
"""Title, reason, experiment that covers it."""
