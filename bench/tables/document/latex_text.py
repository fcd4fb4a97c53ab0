"""Text in LaTeX: what has a meaning there is escaped, and all of it is ASCII."""

from __future__ import annotations

import unicodedata

from bench.plain_text import plain_line

_SIGNS = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    # In LaTeX's default encoding these would come out as other signs.
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
    "±": r"$\pm$",
    "\u2212": r"$-$",
    "\u00d7": r"$\times$",
    "†": r"$^\dagger$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "→": r"$\to$",
    "…": r"\ldots{}",
    "\u2013": "--",
    "\u2019": "'",
    '"': "''",
}


def latex_text(text: str) -> str:
    """``text`` as LaTeX prints it in any encoding; letters lose their accents, other unknown signs become "?"."""
    return "".join(_sign(sign) for sign in plain_line(text))


def _sign(sign: str) -> str:
    if sign.isascii() or sign in _SIGNS:
        return _SIGNS.get(sign, sign)
    # What it is made of may have a meaning too: a full-width dollar is a dollar.
    plain = "".join(_SIGNS.get(part, part) for part in unicodedata.normalize("NFKD", sign) if part.isascii())
    return plain or "?"
