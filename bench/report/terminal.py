"""A line on the terminal: plain text, whatever is in it."""

from __future__ import annotations

from rich.console import Console

from bench.plain_text import plain_line


def say(text: str, console: Console) -> None:
    """Print ``text`` as one line of plain text, which only the terminal breaks: no markup, colours or emoji codes."""
    console.print(plain_line(text), markup=False, highlight=False, emoji=False, soft_wrap=True)
