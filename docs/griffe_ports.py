"""Griffe extension: shows the ports and states that a docstring lists as Markdown lists."""

import importlib
import inspect
import re
from typing import Any

import griffe

SECTION = re.compile(r"^(Input ports?|Output ports?|States?|Parameters?)[^:\n]*:$", re.MULTILINE)
ENTRY = re.compile(r"^ {4}(?=\S)")
NAME = re.compile(r"^([\w<>/ ]+?)(?= \(|:|,)")


def with_lists(text: str) -> str:
    """A docstring whose port sections are headed lists; other sections stay as they are."""
    out: list[str] = []
    inside = False
    for line in text.splitlines():
        if SECTION.match(line):
            inside = True
            out += ["", f"**{line[:-1]}**", ""]
        elif inside and ENTRY.match(line):
            out.append("- " + NAME.sub(r"`\1`", line.strip()))
        elif inside and line.startswith(" " * 5):
            out[-1] += " " + line.strip()
        else:
            if inside:
                out.append("")
            inside = False
            out.append(line)
    return "\n".join(out)


class Ports(griffe.Extension):
    """Rewrites docstrings before they are parsed."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = with_lists(obj.docstring.value)

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Gives an instance of a Drake template the docstring of its class."""
        if str(attr.value) == f"{attr.name}_[None]":
            made = getattr(importlib.import_module(attr.module.path), attr.name)
            attr.docstring = griffe.Docstring(with_lists(inspect.getdoc(made) or ""), parent=attr)
