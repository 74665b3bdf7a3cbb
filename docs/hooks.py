"""MkDocs hooks: the site has whole texts where pages in the repository have tables of names, and links.

Equations become MathML, which browsers show without a script.
"""

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

ROOT = Path(__file__).resolve().parents[1]
# Pages that only lead to a file of the repository's root.
ROOT_FILES = {"reference/changelog.md": "CHANGELOG.md", "reference/security.md": "SECURITY.md"}
OBJECTS = re.compile(r'<!-- \[\[\[cog cog.outl\(api_table\("(.*?)"\)\) .*?<!-- \[\[\[end]]] -->', re.DOTALL)
# Options of mkdocstrings for single names; those of other modules are MODULE.
MODULE = "{ show_root_heading: false, show_root_toc_entry: false }"
OPTIONS = {
    "geort_drake.hands.description.HandDescription": (
        "{ members: [joint_names, finger_names, human_keypoints, validate] }"
    ),
    "geort_drake.errors": MODULE,
    "geort_drake.people.keypoints": MODULE,
}

MATH = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
# Browsers ignore MathML's mathvariant, so these letters are given as characters of their own.
LETTERS = {r"\mathcal L": "ℒ", r"\mathcal N": "𝒩", r"\mathbb E": "𝔼"}


def on_page_markdown(markdown: str, page: Any, **_: object) -> str:
    """Replaces a page that leads to a file by this file, and a table of names by their docstrings."""
    if page.file.src_uri in ROOT_FILES:
        return (ROOT / ROOT_FILES[page.file.src_uri]).read_text("utf-8")

    def docstrings(found: re.Match) -> str:
        names = found[1].split()
        options = (f"\n    options: {OPTIONS[name]}" if name in OPTIONS else "" for name in names)
        return "\n".join(f"::: {name}{option}" for name, option in zip(names, options, strict=True))

    return OBJECTS.sub(docstrings, markdown)


def on_page_content(html_text: str, **_: object) -> str:
    """Renders LaTeX as MathML, which browsers show without a script."""

    def render(found: re.Match) -> str:
        latex = html.unescape(found[2]).strip()
        for name, letter in LETTERS.items():
            latex = latex.replace(name, letter)
        mathml = convert(latex, display="block" if found[1] == "div" else "inline")
        mathml = mathml.replace("&#x0005E;</mo></mover>", "&#x002C6;</mo></mover>")  # a hat that sits close
        return mathml.replace("<mi>&#x0007E;</mi>", "<mo>&#x0223C;</mo>")  # a relation, with space around it

    return MATH.sub(render, html_text)
