"""MkDocs hook: renders equations as MathML, which browsers show without a script."""

import html
import re

from latex2mathml.converter import convert

MATH = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
# Browsers ignore MathML's mathvariant, so these letters are given as characters of their own.
LETTERS = {r"\mathcal L": "ℒ", r"\mathcal N": "𝒩", r"\mathbb E": "𝔼"}


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
