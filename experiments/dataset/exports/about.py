"""Who may do what with a dataset, and what to call it: title, version, licence, citation."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from experiments.dataset.settings import Config
    from render.catalogue.record import StarCatalog

__all__ = ["about"]

_GAIA = "CC-BY-SA-3.0-IGO"


def about(config: Config, catalogue: StarCatalog) -> dict[str, str]:
    """Title, version, licence (SPDX identifier), licence_url, citation; each on one line."""
    card = config.card
    shared = _GAIA if "CC BY-SA 3.0 IGO" in catalogue.attribution else ""
    licence = card.licence or shared
    said = {
        "title": card.title,
        "version": card.version,
        "licence": licence or "that of the star catalogue",
        "licence_url": f"https://spdx.org/licenses/{licence}.html" if licence else "",
        "citation": card.citation or f"{card.title}, version {card.version}, made by starbench; {catalogue.source}",
    }
    return {name: " ".join(text.split()) for name, text in said.items()}
