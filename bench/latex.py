"""A table as LaTeX: booktabs rules, multirow groups, arrows and bold, for a paper's source or as a whole document."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

from bench.tableformat import Row, Table

__all__ = ["escape", "latex_document", "latex_table"]

# Not every TeX installation has multirow; without it the group's name stands on its first row.
_PREAMBLE = r"""\documentclass[10pt]{article}
\usepackage[a4paper,landscape,margin=12mm]{geometry}
\usepackage[utf8]{inputenc}
\usepackage{graphicx}
\usepackage{booktabs}
\IfFileExists{multirow.sty}{\usepackage{multirow}}{}
\providecommand{\multirow}[3]{#3}
\pagestyle{empty}
\begin{document}
"""

# Box 2 to the text's width, then to most of its height, where it is larger; graphicx itself uses box 0.
_SHRUNK = r"""\ifdim\wd2>\textwidth\setbox2=\hbox{\resizebox{\textwidth}{!}{\box2}}\fi
\ifdim\dimexpr\ht2+\dp2\relax>.85\textheight\setbox2=\hbox{\resizebox*{!}{.85\textheight}{\box2}}\fi
\leavevmode\box2
"""

_SYMBOLS = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "[": "{[}",  # after a row's end a bracket or a star would be an argument
    "*": "{*}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\char34{}",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "−": r"$-$",
    "·": r"$\cdot$",
    "°": r"\textdegree{}",
    "–": "--",
    "—": "---",
    "…": r"\dots{}",
    "æ": r"\ae{}",
    "ø": r"\o{}",
    "ß": r"\ss{}",
    "ł": r"\l{}",
    "Ł": r"\L{}",
}
# Combining marks that TeX's oldest fonts can put on a letter.
_ACCENTS = frozenset("\u0300\u0301\u0302\u0303\u0308\u030a\u030c\u0327\u0307\u030b")


def escape(text: str) -> str:
    """Text for LaTeX; a character that its fonts lack becomes its code, so that a document always compiles."""
    plain = unicodedata.normalize("NFC", " ".join(text.split()))
    apart = re.sub("-(?=-)", "-\0", plain)  # two hyphens are no dash
    return "".join(map(_escaped, apart)).replace("\0", "{}")


def latex_table(table: Table) -> str:
    """One ``table`` environment; needs booktabs, multirow and graphicx.

    It is shrunk to the page where it is larger. Notes stand below in small print.
    """
    columns = "l" * len(table.label_heads) + "r" * len(table.heads)
    heads = [*table.label_heads, *(head.title for head in table.heads)]
    body = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", _line(map(escape, heads)), r"\midrule"]
    for i, row in enumerate(table.rows):
        body += [r"\midrule"] if i and row.group_start else []
        body.append(_line([*_labels(table.rows, i), *(_cell(c.text, c.bold) for c in row.cells)]))
    body += [r"\bottomrule", r"\end{tabular}"]
    notes = "".join(f"\\par\\noindent {escape(note)}\n" for note in table.notes)
    return (
        "\\begin{table}[!ht]\n\\centering\n"
        f"\\caption{{{escape(table.title)}}}\n\\label{{tab:{_label(table.name)}}}\n"
        "\\setbox2=\\hbox{%\n"
        + "\n".join(body)
        + "}\n"
        + _SHRUNK
        + "\\end{table}\n"
        # Behind the float, not in it: many notes may need a page of their own.
        + (f"{{\\scriptsize\\raggedright\n{notes}\\par}}\n" if notes else "")
    )


def latex_document(tables: Iterable[Table]) -> str:
    """A document that compiles with ``pdflatex`` as it is, a page for each table at least."""
    return _PREAMBLE + "\\clearpage\n".join(latex_table(table) for table in tables) + "\\end{document}\n"


def _labels(rows: Sequence[Row], i: int) -> list[str]:
    """The group's name once, over its rows; a single label stands on every row."""
    labels = rows[i].labels
    if len(labels) == 1:
        return [escape(labels[0])]
    shown = ""
    if rows[i].group_start:
        end = next((j for j in range(i + 1, len(rows)) if rows[j].group_start), len(rows))
        shown = escape(labels[0]) if end - i == 1 else rf"\multirow{{{end - i}}}{{*}}{{{escape(labels[0])}}}"
    return [shown, *map(escape, labels[1:])]


def _cell(text: str, bold: bool) -> str:
    return rf"\textbf{{{escape(text)}}}" if bold else escape(text)


def _line(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _label(name: str) -> str:
    return "".join(char if char.isascii() and char.isalnum() else "-" for char in name)


def _escaped(char: str) -> str:
    if char in _SYMBOLS:
        return _SYMBOLS[char]
    if char in "&%$#_{}":
        return f"\\{char}"
    if " " <= char < "\x7f" or char == "\0":
        return char
    parts = unicodedata.normalize("NFD", char)
    if "À" <= char <= "ž" and len(parts) == 2 and parts[0].isascii() and parts[0].isalpha() and parts[1] in _ACCENTS:
        return char
    return f"(U+{ord(char):04X})"
