"""Text that others may have written, made one line of plain text: the one place that all writers and the terminal ask.

Names of systems, reasons, notes and messages come from run folders and foreign files. Whatever they hold, a reader sees
the words and nothing else happens: no line ends early, no terminal obeys, no sign turns the text around.
"""

from __future__ import annotations

import re
import unicodedata

# ECMA-48: ESC [ (or its one-character form) with parameters and a final letter; ESC ] and its like, up to BEL or ESC \;
# any other ESC with the letter that follows it.
_ESCAPE_SEQUENCE = re.compile(
    r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]?"
    r"|(?:\x1b[\]PX^_]|[\x9d\x90\x98\x9e\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?"
    r"|\x1b[ -/]*[0-~]?"
)
_REPLACEMENT = "\ufffd"
MOST = 5000
"""More characters than this are no sentence; the longest note of the paper's tables has about 500."""


def plain_line(text: str, most: int = MOST) -> str:
    """``text`` as one line of printable characters, with one blank in place of line breaks, tabs and odd spaces.

    Terminal escape sequences, control characters and invisible signs (those that turn the direction of writing among
    them) are left out; half a surrogate pair becomes U+FFFD. Of more than ``most`` characters the middle is left out.
    Text that is plain already comes back as it is.
    """
    if len(text) > 4 * most:
        # Nobody reads megabytes, and cleaning them would take time.
        text = f"{text[: 2 * most]} {text[-2 * most :]}"
    if not text.isprintable():
        kept = (_visible(sign) for sign in _ESCAPE_SEQUENCE.sub("", text))
        text = " ".join("".join(kept).split())
    if len(text) > most:
        head = most * 2 // 3
        text = f"{text[:head]} ... {text[head + 5 - most :]}"
    return text


def _visible(sign: str) -> str:
    if sign.isspace():
        return " "
    category = unicodedata.category(sign)
    if category == "Cs":
        return _REPLACEMENT
    return "" if category.startswith("C") else sign
