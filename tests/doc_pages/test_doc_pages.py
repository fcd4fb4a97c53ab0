"""README.md and docs/: links that lead somewhere in the repository too, and what `make docs` makes of the code."""

from __future__ import annotations

import re
from pathlib import Path
from string import Template

import pytest

from bench import registry
from bench.cli import COMMANDS, parser_of
from tools.doc_pages.links import LINK, for_site

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.finditer(page.read_text(encoding="utf-8")):
        target, anchor = link["target"], (link["anchor"] or "").removeprefix("#")
        file = (page.parent / target).resolve() if target else page
        assert file.exists(), f"{link[0]} leads nowhere"
        if anchor and file.suffix == ".md":
            headings = re.findall(r"(?m)^#+ (.*)", file.read_text(encoding="utf-8"))
            slugs = [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]
            assert anchor in slugs, f"{link[0]}: {file.name} has {slugs}"


def test_readme_is_a_face_and_no_book() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 160
    assert "python" not in lines[0].lower()


def test_readme_shows_the_backbone_that_new_plugin_writes() -> None:
    template = (ROOT / "bench/authoring/templates/stereo.txt").read_text(encoding="utf-8")
    written = Template(template).substitute(name="my_net", Class="MyNet").split("\n\n\n", 1)[1]
    shown = {line.strip() for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines()}
    lacking = [line for line in map(str.strip, written.splitlines()) if line and line not in shown]
    assert [line for line in lacking if "TorchStereo" not in line] == []


def test_every_kind_and_every_command_has_its_place() -> None:
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert [kind for kind in registry.KINDS if f"reference/plugins/{kind}.md" not in site] == []
    named = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    assert [command for command in COMMANDS if not re.search(rf"`(bgs-bench )?{command}\b", named)] == []


def test_links_follow_files_to_where_the_site_has_them() -> None:
    text = "[a](../../README.md) ![b](../images/b.png) [c](#d) [e](http://x.y/z) [f](../../results/tables/f.json#L3)"
    site = "[a](../index.md) ![b](../images/b.png) [c](#d) [e](http://x.y/z) [f](../results/tables/f.json#L3)"
    assert for_site(text, "docs/guide/page.md") == site
    text, site = "[a](docs/guide/page.md#x) [b](CHANGELOG.md)", "[a](guide/page.md#x) [b](changelog.md)"
    assert for_site(text, "README.md") == site
    assert for_site(r"| `a \| b` | c \| d |", "docs/page.md") == r"| `a | b` | c \| d |"


def test_every_command_shows_examples_in_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    for command in COMMANDS:
        with pytest.raises(SystemExit, match="0"):
            parser_of([command]).parse_args([command, "--help"])
        assert f"\n  bgs-bench {command}" in capsys.readouterr().out, f"{command} --help has no example"
