"""Text in LaTeX: what has a meaning there is escaped, and all of it is ASCII."""

from __future__ import annotations

import unicodedata

from bench.tables.document.model import on_one_line

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
    return "".join(_SIGNS.get(sign) or _ascii(sign) for sign in on_one_line(text))


def _ascii(sign: str) -> str:
    if sign.isascii():
        return sign
    plain = "".join(part for part in unicodedata.normalize("NFKD", sign) if part.isascii())
    return plain or "?"
