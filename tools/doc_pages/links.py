"""Links of Markdown files: written so that they lead somewhere in the repository, and rewritten for the site."""

from __future__ import annotations

import os
import posixpath
import re

LINK = re.compile(r"(?<=\]\()(?P<target>[^)\s#]*)(?P<anchor>#[^)\s]*)?(?=\))")
"""The target and the anchor of a Markdown link or image."""
_CODE = re.compile(r"`[^`\n]+`")
AS_PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Files at the root that are pages of the site too."""


def place_on_site(file: str) -> str:
    """Where a file of the repository is on the site, by its path below the root: ``docs/a.md`` is ``a.md`` there."""
    return AS_PAGES.get(file) or file.removeprefix("docs/")


def for_site(text: str, file: str) -> str:
    """The Markdown of ``file``, a path below the repository's root, with its links as the site has them."""
    page = posixpath.dirname(place_on_site(file))

    def rewritten(link: re.Match[str]) -> str:
        target = link["target"]
        if not target or ":" in target:
            return link[0]
        whole = posixpath.normpath(posixpath.join(posixpath.dirname(file), target))
        return os.path.relpath(place_on_site(whole), page or ".") + (link["anchor"] or "")

    # What readers of Markdown elsewhere want escaped in the code of a table's cell, MkDocs would show.
    return _CODE.sub(lambda code: code[0].replace("\\|", "|"), LINK.sub(rewritten, text))
