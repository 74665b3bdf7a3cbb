"""README and docs: their code blocks and the commands that they show."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


def fences(page: Path, *languages: str) -> list[str]:
    """Contents of fenced blocks without their indentation; the site shows included programs as such."""
    text = re.sub(
        r"^\{\{ python (\S+) \}\}$",
        lambda name: f"```python\n{(ROOT / name[1]).read_text('utf-8')}```",
        page.read_text("utf-8"),
        flags=re.MULTILINE,
    )
    found = []
    for indent, language, body in FENCE.findall(text):
        if language in languages:
            lines = [line.removeprefix(indent) for line in body.splitlines()]
            found.append("\n".join(lines) + "\n")
    return found


def title(page: Path) -> str:
    return page.relative_to(ROOT).as_posix().removeprefix("docs/")


def lines_of(page: Path) -> list[str]:
    """Lines of shell blocks, continued ones joined, and inline code."""
    blocks = [body.replace("\\\n", " ") for body in fences(page, "sh")]
    inline = [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", page.read_text("utf-8"))]
    return [line.strip() for body in blocks for line in body.splitlines()] + inline
