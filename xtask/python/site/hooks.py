"""Hooks of MkDocs: pages beside docs/, links into the repository, anchors as on GitHub, formulas, the live page, fonts.

A page of the repository keeps its relative links. Here they are mapped to places in the site: `docs/` is its root, README.md its front page,
notebooks and scenes have pages of their own, and every other file that a page links to is copied as text below `source/`.
"""

import io
import posixpath
import re
import subprocess
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import formulas
import notebooks
import reference
import ziamath
from fontTools import subset
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.nav import Navigation
from mkdocs.structure.pages import Page

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[2]
LIVE = REPOSITORY / "target" / "page" / "fivebar.html"

PAGES = {"README.md": "index.md"} | {name: name for name in ("ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")}
"""Pages outside docs/, and their places in the site."""

PARTS = re.compile(
    r"^ *```.*?^ *```[^\S\n]*$|`[^`\n]+`|(?P<open>!?\[(?:[^\]\[]|\[[^\]]*\])*\]\()(?P<link>[^)\s]+)\)",
    re.MULTILINE | re.DOTALL,
)
"""Code, which stays, and links."""

SHELL = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)

WIDEST = 60
"""Letters of a line of a shell with a comment; longer lines wrap, and their comments with them."""

UNUSED = ("404.html", "*.map", "assets/javascripts/lunr/**/*.js", "sitemap.xml*", "search/search_index.json")
"""Files of theme and plugins that a page without a network and in English does not read."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Formulas, and anchors as GitHub makes them."""
    config.markdown_extensions.append(formulas.Formulas())
    config.mdx_configs["pymdownx.superfences"] = {
        "custom_fences": [{"name": "math", "class": "formula", "format": formulas.block}]
    }
    config.mdx_configs["toc"]["slugify"] = anchor
    return config


def anchor(heading: str, _: str) -> str:
    """The name by which GitHub links to a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds pages from elsewhere in the repository, the generated reference, and files that pages link to."""

    def add(uri: str, content: str | bytes) -> None:
        files.append(File.generated(config, uri, content=content))

    for name, uri in PAGES.items():
        add(uri, (REPOSITORY / name).read_text(encoding="utf-8"))
    for notebook in sorted((REPOSITORY / "examples").glob("*.ipynb")):
        for name, content in notebooks.page(notebook).items():
            add(f"examples/{name}", content)
    for uri, content in reference.pages().items():
        add(uri, content)
    for asset in ("site.css", "variables.js", "iframe-worker.js"):
        add(f"assets/{asset}", (HERE / asset).read_text(encoding="utf-8"))
    add("assets/math.woff", font())
    if LIVE.is_file():
        add("live/fivebar.html", LIVE.read_bytes())
    for name in sorted(linked(files)):
        add(*source(name))
    return files


def linked(files: Files) -> set[str]:
    """Files and folders of the repository that have no page of their own and are linked to."""
    found: set[str] = set()
    for file in files.documentation_pages():
        for part in PARTS.finditer(file.content_string):
            target = elsewhere(file, part, files)
            if target and place(target).startswith("source/"):
                found.add(target)
    # A folder's list links to its files.
    for name in [each for each in found if (REPOSITORY / each).is_dir()]:
        found |= set(tracked(name))
    return found


def elsewhere(file: File, part: re.Match[str], files: Files) -> str:
    """The file or folder of the repository that a link of a page leads to; empty for other parts, and for links that are right in the site."""
    path, link = in_repository(file.src_uri), part["link"]
    if not path or not link or re.match(r"[a-z]+:|#", link):
        return ""
    name = unquote(link.partition("#")[0])
    if files.get_file_from_path(posixpath.normpath(posixpath.join(posixpath.dirname(file.src_uri), name))):
        return ""
    return posixpath.normpath(posixpath.join(posixpath.dirname(path), name))


def in_repository(uri: str) -> str:
    """The file of the repository that a page comes from; empty if the page is generated."""
    if uri.startswith(("reference/", "source/", "examples")):
        return f"{uri.removesuffix('.md')}.ipynb" if uri.startswith("examples/") else ""
    return next((name for name, page in PAGES.items() if page == uri), f"docs/{uri}")


def place(name: str) -> str:
    """The place in the site of a file or folder of the repository, with an anchor if it is part of a page."""
    path = REPOSITORY / name
    if not path.exists():
        raise PluginError(f"a page links to {name}, which is not there")
    if name in PAGES:
        return PAGES[name]
    if name.startswith("docs/"):
        return name.removeprefix("docs/")
    if name in ("scenes", "examples"):
        return "reference/scenes.md" if name == "scenes" else "examples.md"
    if name.startswith("scenes/"):
        return f"reference/scenes.md#{path.stem}"
    if name.startswith("examples/"):
        return f"examples/{path.stem}.md" if path.suffix == ".ipynb" else f"examples.md#{anchor(path.name, '-')}"
    return f"source/{name}.md" if path.is_dir() else f"source/{name}.txt"


def source(name: str) -> tuple[str, str]:
    """A copy of a file as text; of a folder a list of its files."""
    path = REPOSITORY / name
    if path.is_file():
        return place(name), path.read_text(encoding="utf-8")
    rows = [f"- [`{each}`]({posixpath.relpath(place(each), posixpath.dirname(place(name)))})" for each in tracked(name)]
    return place(name), "\n".join(["---", "search:", "  exclude: true", "---", f"# {name}/", "", *rows, ""])


@cache
def tracked(folder: str) -> list[str]:
    """The files of a folder of the repository, without those of its folders."""
    listed = subprocess.run(["git", "ls-files", folder], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    return [name for name in listed.stdout.split() if posixpath.dirname(name) == folder]


TITLES: dict[str, str] = {}
"""Titles of the pages of docs/ in the navigation, by place; of notes their headings, such as "notes on the estimator"."""


def on_nav(nav: Navigation, **_: object) -> Navigation:
    """Stores the titles."""
    for page in nav.pages:
        uri = page.file.src_uri
        if page.title and in_repository(uri).startswith("docs/"):
            heading = page.file.content_string.partition("\n")[0].removeprefix("# ")
            TITLES[uri] = heading[:1].lower() + heading[1:] if uri.startswith("notes/") else page.title
    return nav


def titled(opening: str, uri: str) -> str:
    """The text of a link, which is the page's title, in italics, if the Markdown has the name of the file."""
    return f"[*{TITLES[uri]}*](" if uri in TITLES and re.fullmatch(r"\[[\w./-]+\.md\]\(", opening) else opening


def on_page_markdown(markdown: str, page: Page, files: Files, **_: object) -> str:
    """Leads links of a page of the repository to their places in the site."""
    uri = page.file.src_uri

    def placed(part: re.Match[str]) -> str:
        target = elsewhere(page.file, part, files)
        if not target:
            if not part["link"]:
                return part[0]
            there = posixpath.normpath(posixpath.join(posixpath.dirname(uri), part["link"].partition("#")[0]))
            return f"{titled(part['open'], there)}{part['link']})"
        there, _, own = place(target).partition("#")
        fragment = part["link"].partition("#")[2] or own
        return f"{titled(part['open'], there)}{posixpath.relpath(there, posixpath.dirname(uri) or '.')}{'#' if fragment else ''}{fragment})"

    markdown = SHELL.sub(lambda block: f"```sh\n{comments_above(block[1])}```", PARTS.sub(placed, markdown))
    if uri == "index.md" and LIVE.is_file():
        markdown = re.sub(r"^!\[.*?\]\(.*?\)$", live, markdown, count=1, flags=re.MULTILINE)
    return markdown


def comments_above(block: str) -> str:
    """Lines of a shell; if a line with a comment is wide, each comment stands above its command."""
    commands = re.split(r"(?<!\\)\n", block.rstrip("\n"))
    if not any(" # " in line and len(line) > WIDEST for line in block.splitlines()):
        return block
    lines = []
    for command in commands:
        comments = re.findall(r"(?<=\s)# .*$", command, re.MULTILINE)
        lines += [*comments, re.sub(r"\s+# .*$", "", command, flags=re.MULTILINE)]
    return "\n".join([*lines, ""])


def live(picture: re.Match[str]) -> str:
    """The live page in the place of the picture that the README has."""
    return (
        '<figure class="live"><iframe src="live/fivebar.html" title="The live five-bar: drag its tip" allow="clipboard-write"'
        ' loading="lazy"></iframe><figcaption>The unit itself computes this machine in your browser: drag its tip.'
        ' <a href="live/fivebar.html">Open it alone</a>, <a href="page.html">how it works</a>.</figcaption></figure>'
    )


@cache
def font() -> bytes:
    """STIX Two Math with the characters that formulas have: browsers take stretched brackets and roots from a font's table MATH."""
    file = Path(ziamath.__file__).with_name("fonts") / "STIXTwoMath-Regular.ttf"
    options = subset.Options(flavor="woff", layout_features=["*"], notdef_outline=True)
    with subset.load_font(str(file), options) as loaded:
        subsetter = subset.Subsetter(options)
        subsetter.populate(unicodes=[code for code in loaded.getBestCmap() if in_formulas(code)])
        subsetter.subset(loaded)
        loaded["head"].modified = loaded["head"].created
        loaded.recalcTimestamp = False
        output = io.BytesIO()
        loaded.flavor = "woff"
        loaded.save(output)
    return output.getvalue()


def in_formulas(code: int) -> bool:
    """Latin, Greek, combining accents, arrows, operators, brackets, mathematical italic, bold and script."""
    return any(low <= code <= high for low, high in RANGES)


RANGES = (
    (0x20, 0x7E), (0xA0, 0x17F), (0x2C6, 0x2DD), (0x300, 0x338), (0x391, 0x3F5), (0x2010, 0x205F), (0x2061, 0x2064), (0x20D0, 0x20DC),
    (0x2100, 0x2138), (0x2190, 0x21FF), (0x2200, 0x22FF), (0x2300, 0x23B5), (0x27E6, 0x27EF), (0x2A00, 0x2A7F), (0x1D400, 0x1D7FF),
)  # fmt: skip


CELL = re.compile(r"<td.*?</td>", re.DOTALL)
TEXT = re.compile(r"(?<=>)[^<>]+(?=<)")
SMALL = re.compile(r"(?<![\w.])\d+(?:\.\d+)?e-\d+")
"""A number that browsers would break behind its hyphen."""

NAME = re.compile(r"(?<=\w)(?:::|[_./=])(?=\w)|(?<=\w)(?=[\[(])|,(?=\S)")
"""Places at which a name in a cell may break."""

EMPTY_HEAD = re.compile(r"<th((?: [^>]*)?)></th>")
DIALOG = 'data-md-component="search" role="dialog"'


def on_post_page(output: str, **_: object) -> str:
    """Lets names in cells break behind their parts, and numbers not at all, so that columns keep a readable width on a telephone. For screen
    readers the dialog of the search gets a name, and an empty head of a table is a plain cell."""

    def text(part: re.Match[str]) -> str:
        if SMALL.search(part[0]):
            return SMALL.sub(r'<span class="number">\g<0></span>', part[0])
        return NAME.sub(r"\g<0><wbr>", part[0]) if max(map(len, part[0].split()), default=0) > 8 else part[0]

    named = EMPTY_HEAD.sub(r"<td\1></td>", output.replace(DIALOG, f'{DIALOG} aria-label="Search"'))
    return CELL.sub(lambda cell: TEXT.sub(text, cell[0]), named)


@event_priority(-200)
def on_post_build(config: MkDocsConfig) -> None:
    """Removes what no page reads, after the plugin `offline` has written the search index in the form that it needs."""
    for pattern in UNUSED:
        for file in Path(config.site_dir).glob(pattern if "/" in pattern else f"**/{pattern}"):
            file.unlink()
