"""Names in code type lead to their pages: `find_stars` or `optics.rays.trace.trace` in any text is a link to the API.

A name with dots that begins with one of the packages must name something; if it does not, the build says so.
"""

from __future__ import annotations

import re

from api_pages import PACKAGES, public_names, resolve
from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

LOGGER = logging.getLogger(__name__)
NAME = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(?:\(.*\))?")
DOTTED = re.compile(rf"(?:{'|'.join(PACKAGES)})(?:\.[A-Za-z_]\w*)+")
FILES = (".py", ".toml", ".md", ".html", ".json", ".png", ".csv")


class CodeLinks(SphinxPostTransform):
    """Turn literals that are names of the API into references."""

    default_priority = 5

    def run(self, **kwargs: object) -> None:
        """Go through the literals of the page."""
        if self.env.docname.startswith(("api/", "changelog")):  # a changelog may name what is gone
            return
        short = {name.split(".")[1]: name for name in public_names()}
        domain = self.env.domains.python_domain
        for literal in list(self.document.findall(nodes.literal)):
            match = NAME.fullmatch(literal.astext())
            if match is None or isinstance(literal.parent, nodes.reference | pending_xref):
                continue
            name = match[1]
            full = short.get(name, name)
            if full in domain.objects:
                entry = domain.objects[full]
                link = make_refnode(
                    self.app.builder, self.env.docname, entry.docname, entry.node_id, [literal.deepcopy()], full
                )
                literal.replace_self(link)
            elif DOTTED.fullmatch(name) and not name.endswith(FILES) and resolve(name) is None:
                LOGGER.warning("%s names nothing in the packages", name, location=literal)


def to_changelog(app: Sphinx, docname: str, source: list[str]) -> None:
    """Links to the changelog at the root of the repository lead to the page that shows it."""
    source[0] = source[0].replace("](../CHANGELOG.md)", "](changelog.md)")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the transform."""
    app.add_post_transform(CodeLinks)
    app.connect("source-read", to_changelog)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
