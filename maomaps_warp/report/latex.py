"""Text for LaTeX."""

from __future__ import annotations

_SPECIAL = {
    **{character: "\\" + character for character in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "\\": r"\textbackslash{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "\N{NO-BREAK SPACE}": r"\,",
}


def latex_text(text: str) -> str:
    """A text with LaTeX's special characters escaped; blanks between digits become thin spaces."""
    return "".join(_SPECIAL.get(character, character) for character in text)
