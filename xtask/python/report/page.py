"""The page: sections in the order of the contents, each with text, figures, tables and links to its data."""

import html
import io
import re
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

TEMPLATE = Path(__file__).with_name("page.html")


def compact(drawing: str) -> str:
    """An SVG with two decimals instead of matplotlib's six: a hundredth of a point is invisible. Numbers below 1 are
    scales and stay."""
    return re.sub(r"(?<![\d.])([1-9]\d*\.\d\d)\d+", r"\1", drawing)


def svg(figure: Figure, name: str, alt: str) -> str:
    """The figure as an inline SVG element; its ids get a prefix, because many figures share a page."""
    text = io.StringIO()
    with plt.rc_context({"svg.hashsalt": f"fivebar-{name}"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    plt.close(figure)
    drawing = compact(text.getvalue())
    drawing = drawing[drawing.index("<svg") :]
    # Equal images would have equal ids; nothing refers to them.
    drawing = re.sub(r' id="image[0-9a-f]+"', "", drawing)
    # Fonts have the same ids in every figure, and clip paths may too.
    drawing = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{name}-", drawing)
    label = html.escape(alt, quote=True)
    # Width and height follow the page, up to the drawn size; the viewBox keeps the aspect ratio.
    return re.sub(r'<svg ([^>]*?)width="([^"]*)"', rf'<svg role="img" aria-label="{label}" style="max-width: \2" \1', re.sub(r'(<svg [^>]*?)height="[^"]*" ', r"\1", drawing, count=1), count=1)  # fmt: skip


# Characters. Longer texts may wrap in a table.
SENTENCE = 48


def table(head: list[str], rows: list[list[str]], numbers: tuple[int, ...] = ()) -> str:
    """A table of HTML cells; the columns `numbers` are aligned right, and a sentence may take several lines."""

    def line(tag: str, cells: list[str]) -> str:
        kinds = (
            ' class="n"' if i in numbers else ' class="long"' if "<" not in c and len(c) > SENTENCE else ""
            for i, c in enumerate(cells)
        )
        return "".join(f"<{tag}{kind}>{c}</{tag}>" for kind, c in zip(kinds, cells, strict=True))

    body = "\n".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{line("th", head)}</tr></thead><tbody>\n{body}\n</tbody></table></div>'
    )


@dataclass
class Section:
    """A numbered part of the page."""

    id: str
    title: str
    parts: list[str] = field(default_factory=list)

    def text(self, paragraph: str) -> None:
        """A paragraph of HTML."""
        self.parts.append(f"<p>{paragraph}</p>")

    def figure(self, figure: Figure, name: str, caption: str, data: list[str]) -> None:
        """A figure with its caption and links to the files of its data."""
        self.parts.append(figure_element(figure, name, caption, data))

    def missing(self, what: str, command: str) -> None:
        """States that something is left out, and the command that adds it."""
        self.parts.append(f'<p class="missing">Left out: {what}. <code>{html.escape(command)}</code> measures it.</p>')

    def bullets(self, lines: list[str]) -> None:
        """A list."""
        self.parts.append("<ul>" + "\n".join(f"<li>{line}</li>" for line in lines) + "</ul>")

    def folded(self, summary: str, content: str) -> None:
        """A collapsed part, which most readers skip."""
        self.parts.append(f"<details><summary>{summary}</summary>{content}</details>")


def figure_element(figure: Figure, name: str, caption: str, data: list[str]) -> str:
    """A figure with its caption and links to the files of its data."""
    links = ", ".join(f'<a href="data/{file}">{file}</a>' for file in data)
    drawing = svg(figure, name, re.sub(r"<[^>]+>", "", caption))
    return f'<figure id="figure-{name}">{drawing}<figcaption>{caption} Data: {links}.</figcaption></figure>'


def write(path: Path, sentences: list[tuple[str, str]], main: str, sections: list[Section]) -> None:
    """Fills the template."""
    numbered = list(enumerate(sections, start=1))
    body = "\n".join(
        f'<section id="{s.id}"><h2><b>{n}</b>{s.title}</h2>\n{chr(10).join(s.parts)}\n</section>' for n, s in numbered
    )
    fill = {
        "contents": "\n".join(f'<li><a href="#{s.id}">{s.title}</a></li>' for s in sections),
        "sentences": "\n".join(f"<dt>{html.escape(kind)}</dt><dd>{text}.</dd>" for kind, text in sentences),
        "main": main,
        "sections": body,
    }
    page = TEMPLATE.read_text(encoding="utf-8")
    # One pass, so that inserted text is not searched again.
    page = re.sub(r"\{\{(\w+)\}\}", lambda match: fill[match[1]], page)
    path.write_text(page, encoding="utf-8")
