"""What MkDocs calls while it makes the site (mkdocs.yml names this file): adds the pages that come from the code and
from files outside docs/, and rewrites links. So nothing on the site can be older than the code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from bench import registry
from bench.discovery import load_plugins
from tools.doc_pages import links, reference

_COMMANDS = "<!-- generated: commands -->"
_KEPT = ("results/tables", "results/gpu", "results/published")


def on_files(files: Files, *, config: Any) -> Files:
    """Add the reference pages, README and its like, and the kept tables that pages link to."""
    load_plugins()
    for source, page in links.AS_PAGES.items():
        text = links.for_site(Path(source).read_text(encoding="utf-8"), source)
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "reference/settings.md", content=reference.settings_text()))
    for kind in registry.KINDS:
        files.append(File.generated(config, f"reference/plugins/{kind}.md", content=reference.kind_text(kind)))
    for folder in _KEPT:
        for file in sorted(Path(folder).glob("*")):
            # A kept table in Markdown is linked to as a file, not made a page.
            files.append(File.generated(config, file.as_posix(), content=file.read_bytes()))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Files) -> str:
    """A page of docs/ with its links as the site has them, and the commands' help in its place."""
    if page.file.generated_by is None:
        markdown = links.for_site(markdown, f"docs/{page.file.src_uri}")
    return markdown.replace(_COMMANDS, reference.commands_text()) if _COMMANDS in markdown else markdown
