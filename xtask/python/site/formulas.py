"""Formulas of the pages: TeX becomes MathML when the site is built, so that no script and no network is needed to show it."""

import re
from functools import cache
from xml.etree import ElementTree

from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from math_core import LatexError, LatexToMathML
from pymdownx.superfences import SuperFencesException

LONG = 40
"""Characters of TeX beyond which a formula in a line may be wider than a telephone; site.css lets it scroll by itself."""

NUMBER = re.compile(r"\\tag\{(\w+)\}")


@cache
def mathml(tex: str, display: bool) -> str:
    """The MathML of a formula. Raises LatexError if the formula is wrong."""
    return LatexToMathML().convert_with_local_state(tex.strip(), displaystyle=display)


def block(source: str, *_: object, **__: object) -> str:
    r"""A block ```math; its number `\tag{…}` becomes an anchor and stands at the right.

    A wrong formula ends the build; any other exception would make superfences show the block as code.
    """
    number = NUMBER.search(source)
    try:
        formula = mathml(NUMBER.sub("", source), display=True)
    except LatexError as error:
        raise SuperFencesException(f"the formula {source!r}: {error}") from error
    if not number:
        return f'<div class="formula">{formula}</div>'
    return f'<div class="formula" id="equation-{number[1]}">{formula}<span>({number[1]})</span></div>'


class Formulas(Extension):
    """Formulas between dollars, within a line, as GitHub reads them."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Behind code, before everything that could read underscores and backslashes."""
        md.inlinePatterns.register(Between(r"(?<![\\\w$])\$(?=\S)([^$\n]+?)(?<=\S)\$(?![\w$])", md), "formula", 185)


class Between(InlineProcessor):
    """One formula."""

    def __init__(self, pattern: str, markdown: Markdown):
        super().__init__(pattern)
        self.markdown = markdown

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str | ElementTree.Element, int, int]:  # type: ignore[override]
        """Stored as finished HTML."""
        formula = f"<span>{mathml(m[1], display=False)}</span>" if len(m[1]) > LONG else mathml(m[1], display=False)
        return self.markdown.htmlStash.store(formula), m.start(0), m.end(0)
